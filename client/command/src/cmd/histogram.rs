//! `histogram`: the distribution of q, and what thresholds keep of it.

use std::collections::BTreeMap;

use clap::Args;
use gleaner_client::Client;
use gleaner_core::proto::score::expert_ranking;
use gleaner_core::selection::ExpertRanking;
use gleaner_proto::v1::{CohortCounts, GetHistogramRequest, GetHistogramResponse, KeptCount};

use super::selection::decimals;
use crate::context::Context;
use crate::failure::Result;
use crate::output::terminal_width;
use crate::table::Column::{Left, Right};
use crate::table::table;
use crate::{chart, json, words};

/// Columns of the distribution of a cohort at most.
const PLACES: usize = 20;
/// The rows of experts, and of episodes without a cohort; neither can be mistaken for the name of a cohort.
const EXPERTS: &str = "(experts)";
const NAMELESS: &str = "(none)";

#[derive(Args, Debug)]
pub(crate) struct HistogramArgs {
    /// Id of the score run.
    run: String,
    /// Thresholds, 0 to 1, for which kept segments are counted.
    #[arg(long, value_delimiter = ',', default_value = "0.1,0.3,0.5,0.7,0.9")]
    beta: Vec<f64>,
    /// Number of bins of the histogram, at most 1000. More bins show finer detail.
    #[arg(long, default_value_t = 20)]
    bins: u32,
}

impl HistogramArgs {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let request = GetHistogramRequest { score_run_id: self.run.clone(), bins: self.bins, betas: self.beta };
        let reply = context.client().await?.scores().get_histogram(request).await?.into_inner();
        context.output.result(|| json::value(&reply), || histogram(&reply, terminal_width()))?;
        context.output.next(format_args!("gleaner dataset create --run {}", self.run));
        Ok(())
    }
}

/// Bars of the counts, and what each threshold keeps.
pub(crate) fn histogram(histogram: &GetHistogramResponse, width: usize) -> String {
    let most = histogram.counts.iter().copied().max().unwrap_or(0);
    // Enough decimals for the edges of neighbouring bins to differ.
    let places = if histogram.counts.len() > 100 { 3 } else { 2 };
    let room = width.saturating_sub(22 + 2 * places).clamp(10, 60);
    #[expect(clippy::cast_precision_loss, reason = "there are at most 1000 bins")]
    let edge = |bin: usize| bin as f64 / histogram.counts.len() as f64;
    let mut lines = vec![format!("q of {} segments", histogram.segments)];
    for (bin, &count) in histogram.counts.iter().enumerate() {
        let bar = chart::bar(count, most, room);
        lines.push(format!("{:.places$}–{:.places$} {count:>8} {bar}", edge(bin), edge(bin + 1)).trim_end().to_owned());
    }
    let columns = [Right("β"), Right("KEPT"), Right("SHARE"), Right("FROM EPISODES"), Right("OF EXPERTS")];
    let row = |kept: &KeptCount| {
        [
            decimals(kept.beta),
            kept.segments.to_string(),
            words::percent(kept.segments, histogram.segments),
            kept.episodes.to_string(),
            of_experts(histogram, kept),
        ]
    };
    let ranking = expert_ranking(histogram);
    if let Some(all) = ranking.all {
        lines.push(String::new());
        lines.push(format!("an expert's segment has the higher q in {} of pairs (ties count half)", share(all)));
        lines.extend(warnings(&ranking, 0.0));
    }
    lines.push(String::new());
    lines.push(by_cohort(histogram, &ranking));
    lines.push(String::new());
    lines.push(table(columns, histogram.kept.iter().map(row)));
    lines.join("\n")
}

/// The distribution of q of the experts and of each cohort, as a line of columns up to its own maximum.
fn by_cohort(histogram: &GetHistogramResponse, ranking: &ExpertRanking) -> String {
    let columns = |counts: &[u64]| chart::columns_of(counts, PLACES);
    let mut cohorts: BTreeMap<&str, [String; 2]> = BTreeMap::new();
    for CohortCounts { cohort, counts } in &histogram.cohort_counts {
        cohorts.entry(cohort).or_default()[1] = columns(counts);
    }
    // The server has no counts of small cohorts among many.
    for (cohort, auroc) in &ranking.cohorts {
        cohorts.entry(cohort).or_default()[0] = share(*auroc);
    }
    let experts = [EXPERTS.to_owned(), String::new(), columns(&histogram.expert_counts)];
    let experts = Some(experts).filter(|_| histogram.expert_counts.iter().any(|&count| count > 0));
    let named = |cohort: &str| if cohort.is_empty() { NAMELESS } else { cohort }.to_owned();
    let rows = cohorts.into_iter().map(|(cohort, [higher, columns])| [named(cohort), higher, columns]);
    let rows = experts.into_iter().chain(rows);
    let table = table([Left("COHORT"), Right("EXPERT HIGHER"), Left("q 0 TO 1")], rows);
    format!("{table}\n(q: each row to its own maximum)")
}

fn share(auroc: f64) -> String {
    format!("{:.0} %", 100.0 * auroc)
}

fn warnings(ranking: &ExpertRanking, left_out_below: f64) -> impl Iterator<Item = String> {
    ranking.warnings(left_out_below).into_iter().map(|warning| format!("warning: {warning}"))
}

/// Notes what a user should look at before they select segments of a finished run. What was asked for is done, so an error
/// here is a note too. `left_out_below` is as for [`ExpertRanking::warnings`].
pub(crate) async fn warn(context: &Context, client: &Client, run: &str, left_out_below: f64) {
    let request = GetHistogramRequest { score_run_id: run.to_owned(), bins: 1, betas: Vec::new() };
    match client.scores().get_histogram(request).await {
        Ok(reply) => {
            let ranking = expert_ranking(reply.get_ref());
            warnings(&ranking, left_out_below).for_each(|warning| context.output.note(warning));
        }
        Err(error) => context.output.note(format_args!("{run} was not compared with its experts: {}", error.message())),
    }
}

/// The share of the experts' segments above a threshold; `-` without scores of experts.
pub(super) fn of_experts(histogram: &GetHistogramResponse, kept: &KeptCount) -> String {
    match histogram.expert_counts.iter().sum() {
        0 => "-".to_owned(),
        all => words::percent(kept.expert_segments, all),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gleaner_proto::v1::CohortAuroc;

    #[test]
    fn the_histogram_is_drawn() {
        let reply = GetHistogramResponse {
            counts: vec![0, 5, 10, 1],
            segments: 16,
            kept: vec![
                KeptCount { beta: 0.5, segments: 11, episodes: 3, expert_segments: 1 },
                KeptCount { beta: 0.9, segments: 0, episodes: 0, expert_segments: 0 },
            ],
            expert_counts: vec![1, 0, 0, 1],
            expert_auroc: Some(0.6),
            cohort_counts: [("late", vec![0, 1, 4, 0]), ("wrong", vec![0, 4, 6, 1])]
                .map(|(cohort, counts)| CohortCounts { cohort: cohort.into(), counts })
                .into(),
            cohorts: [("late", 0.7), ("wrong", 0.5)]
                .map(|(cohort, expert_auroc)| CohortAuroc { cohort: cohort.into(), expert_auroc })
                .into(),
        };
        assert_eq!(
            histogram(&reply, 36),
            "q of 16 segments\n\
             0.00–0.25        0\n\
             0.25–0.50        5 █████\n\
             0.50–0.75       10 ██████████\n\
             0.75–1.00        1 █\n\
             \n\
             an expert's segment has the higher q in 60 % of pairs (ties count half)\n\
             warning: the scores hardly tell cohort \"wrong\" from experts: an expert's step has the higher q in 50 % of pairs. \
             Either its steps are as good, or the scorer does not see what is wrong with them. If steps with a high q are \
             bad, leave its episodes out: `gleaner dataset create --min-expert-auroc 0.55`\n\
             \n\
             COHORT     EXPERT HIGHER  q 0 TO 1\n\
             (experts)                 █  █\n\
             late                70 %   ▂█\n\
             wrong               50 %   ▅█▁\n\
             (q: each row to its own maximum)\n\
             \n   \
             β  KEPT   SHARE  FROM EPISODES  OF EXPERTS\n\
             0.50    11  68.8 %              3      50.0 %\n\
             0.90     0   0.0 %              0       0.0 %"
        );
    }

    #[test]
    fn narrow_bins_and_thresholds_have_the_decimals_that_they_need() {
        let kept = vec![KeptCount { beta: 0.995, ..KeptCount::default() }];
        let drawn = histogram(&GetHistogramResponse { counts: vec![1; 300], kept, ..Default::default() }, 80);
        let edges: Vec<&str> = drawn.lines().skip(1).take(300).filter_map(|line| line.split(' ').next()).collect();
        assert_eq!(edges[..3], ["0.000–0.003", "0.003–0.007", "0.007–0.010"]);
        assert!(drawn.lines().last().unwrap().starts_with("0.995"), "{drawn}");
    }
}
