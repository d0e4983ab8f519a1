//! The summary of a comparison: a column for each scorer, a row for each measure. A cell without a value has the reason.

use super::report::{Auroc, Comparison, LENGTH, STEP, ScorerReport, Separated};
use super::text::{at_equal_length, at_equal_step, percent, percents, plain, table, value};

/// Rows of the table: a measure with a cell for each scorer, and one for each of what separates without looking at a segment.
struct Rows<'a> {
    found: &'a Comparison,
    rows: Vec<Vec<String>>,
}

impl Rows<'_> {
    /// A measure of scorers alone.
    fn add(&mut self, measure: &str, of: impl Fn(&ScorerReport) -> String) {
        let cells = self.found.scorers.iter().map(of).chain(self.found.alone().map(|_| String::new()));
        self.rows.push(std::iter::once(measure.to_owned()).chain(cells).collect());
    }

    /// An area, plain, at equal length and, of segments, at equal step; `none` is the reason why it is missing.
    fn separated(&mut self, name: &str, of: impl Fn(&Separated) -> Option<&Auroc>, none: &str) {
        let scorers = self.found.scorers.iter().map(|scorer| (&scorer.separated, scorer.runs));
        let all: Vec<(&Separated, usize)> =
            scorers.chain(self.found.alone().map(|(_, separated)| (separated, 1))).collect();
        let pairs = all.iter().filter_map(|(separated, _)| of(separated)).map(|auroc| auroc.pairs).max().unwrap_or(0);
        let row = |measure: String, shown: &dyn Fn(&Auroc) -> String| -> Vec<String> {
            let cell = |(separated, runs): &(&Separated, usize)| match of(separated) {
                Some(auroc) => shown(auroc),
                None if *runs == 0 => "no run".to_owned(),
                None => none.to_owned(),
            };
            std::iter::once(measure).chain(all.iter().map(cell)).collect()
        };
        let plain = row(format!("AUROC of {name}"), &|auroc| plain(&auroc.pooled));
        let equal = row(format!("{name} at equal length ({pairs} pairs)"), &at_equal_length);
        let step_pairs = all.iter().filter_map(|(separated, _)| of(separated)).map(|auroc| auroc.step_pairs).max();
        let at_step = step_pairs
            .filter(|pairs| *pairs > 0)
            .map(|pairs| row(format!("{name} at equal step ({pairs} pairs)"), &at_equal_step));
        self.rows.extend([plain, equal].into_iter().chain(at_step));
    }
}

/// The table with its explanation.
pub(super) fn summary(found: &Comparison) -> String {
    let mut rows = Rows { found, rows: Vec::new() };
    rows.add("runs", |scorer| scorer.runs.to_string());
    rows.separated(
        "marks",
        |separated| separated.marked.first(),
        if found.marked == 0 { "no marks" } else { "one class" },
    );
    rows.separated("outcomes", |separated| separated.outcome.as_ref(), "one outcome");
    let none = |scorer: &ScorerReport, none| if scorer.runs == 0 { "no run" } else { none };
    rows.add("correlation with length", |scorer| {
        value(scorer.length.first().and_then(|length| length.spearman), none(scorer, "constant"))
    });
    rows.add("stability", |scorer| {
        value(scorer.stability, none(scorer, if scorer.runs == 1 { "one run" } else { "constant" }))
    });
    if found.marked > 0 {
        rows.add("best part that is good (precision), %", |scorer| {
            percent(scorer.success.precision, none(scorer, "none"))
        });
        rows.add("good segments in the best part (recall), %", |scorer| {
            percent(scorer.success.recall, none(scorer, "none"))
        });
    }
    success(found, &mut rows);
    let labels = found.scorers.iter().map(|scorer| scorer.label.as_str()).chain(found.alone().map(|(label, _)| label));
    let header: Vec<String> = std::iter::once("").chain(labels).map(str::to_owned).collect();
    let policy = found.policy.as_ref().map_or_else(String::new, |policy| {
        let simulated = found.simulation.as_ref().map_or_else(String::new, |task| format!(" and evaluated in {task}"));
        format!(" Success is that of `{policy}`, trained on the experts and the best part{simulated}.")
    });
    format!(
        "Means over runs, with the widest bounds of their 95 % intervals (episodes resampled). Correlations are \
         Spearman's: of an episode's mean q with its length, and for stability of q between two runs. The column \
         \"{LENGTH}\" ranks short episodes first, \"{STEP}\" early steps.{policy}\n\n{}",
        table(&header, &rows.rows)
    )
}

fn success(found: &Comparison, rows: &mut Rows<'_>) {
    let none = match (&found.policy, &found.simulation) {
        (None, _) => "not trained",
        (Some(_), None) => "not simulated",
        (Some(_), Some(_)) => "failed",
    };
    rows.add("success, %", |scorer| percent(scorer.success.mean_of_seeds, none));
    if found.scorers.iter().all(|scorer| scorer.success.pooled.is_none()) {
        return;
    }
    rows.add("95 % Wilson interval over attempts", |scorer| {
        scorer.success.pooled.map_or_else(|| none.to_owned(), |rate| percents((rate.low, rate.high)))
    });
    rows.add("95 % t-interval over seeds", |scorer| match (scorer.success.pooled, scorer.success.interval_of_seeds) {
        (None, _) => none.to_owned(),
        (Some(_), None) => "one rate".to_owned(),
        (Some(_), Some(interval)) => percents(interval),
    });
    rows.add("successes", |scorer| {
        let rate = scorer.success.pooled;
        rate.map_or_else(|| none.to_owned(), |rate| format!("{} of {}", rate.successes, rate.episodes))
    });
}
