//! A comparison as text: Markdown, for terminals and files alike. A cell without a value has the reason.

use super::report::{Agreement, Auroc, Comparison, LengthCorrelation, ScorerReport};
use super::summary::summary;
use super::text::{at_equal_length, at_equal_step, plain, table, value};
use crate::words::counted;

/// The whole text.
pub(super) fn markdown(found: &Comparison) -> String {
    let mut parts = vec![head(found), summary(found)];
    if found.marked > 0 {
        parts.push(marked(found));
    }
    parts.push(agreement(found));
    parts.push(lengths(found));
    parts.push(runs(found));
    let problems: Vec<String> = found
        .problems()
        .into_iter()
        .filter_map(|(label, seed)| Some(format!("- {label}, seed {}: {}\n", seed.seed, seed.problem.as_ref()?)))
        .collect();
    if !problems.is_empty() {
        parts.push(format!("## Problems\n\n{}", problems.concat()));
    }
    parts.join("\n")
}

fn head(found: &Comparison) -> String {
    let segments = found
        .segments
        .map_or_else(String::new, |segments| format!(" with {}", counted(segments, "segment", "segments")));
    let bins: Vec<String> = found
        .length_bins
        .iter()
        .map(|bin| {
            let steps = if bin.from == bin.to { bin.to.to_string() } else { format!("{}–{}", bin.from, bin.to) };
            format!("{steps} ({})", counted(bin.episodes, "episode", "episodes"))
        })
        .collect();
    let outcomes: Vec<String> =
        found.outcomes.iter().map(|(outcome, episodes)| format!("{episodes} {outcome}")).collect();
    let marks = match found.marked {
        0 => "No episode has a mark.".to_owned(),
        marked => format!("{} a mark.", counted(marked, "imperfect episode has", "imperfect episodes have")),
    };
    format!(
        "# Scorers of {}\n\nMade by `{}` on the snapshot {}: {}, {} ({}){segments}. {marks} The \
         best part is {} % of the segments. Equal length compares within these numbers of steps: {}.\n",
        found.task,
        found.command,
        found.snapshot,
        counted(found.experts, "expert", "experts"),
        counted(found.imperfect, "imperfect episode", "imperfect episodes"),
        outcomes.join(", "),
        (found.top_fraction * 1e4).round() / 1e2,
        bins.join(", ")
    )
}

/// AUROC of marked segments by group: a column for each scorer, plain, at equal length and at equal step.
fn marked(found: &Comparison) -> String {
    let mut columns: Vec<(&str, &[Auroc])> =
        found.scorers.iter().map(|scorer| (scorer.label.as_str(), &scorer.separated.marked[..])).collect();
    columns.extend(found.alone().map(|(label, alone)| (label, &alone.marked[..])));
    let mut groups: Vec<&str> = Vec::new();
    for auroc in columns.iter().flat_map(|column| column.1) {
        if !groups.contains(&auroc.pooled.cohort.as_str()) {
            groups.push(&auroc.pooled.cohort);
        }
    }
    let rows = |shown: &dyn Fn(&Auroc) -> String| -> Vec<Vec<String>> {
        let cell = |column: &(&str, &[Auroc]), group: &str| {
            let auroc = column.1.iter().find(|auroc| auroc.pooled.cohort == group);
            auroc.map_or_else(|| "no run".to_owned(), shown)
        };
        let row = |group: &&str| {
            let cells = columns.iter().map(|column| cell(column, group));
            std::iter::once((*group).to_owned()).chain(cells).collect()
        };
        groups.iter().map(row).collect()
    };
    let header: Vec<String> =
        std::iter::once("segments").chain(columns.iter().map(|column| column.0)).map(str::to_owned).collect();
    let equal_header = [&header[..], &["pairs".to_owned()]].concat();
    let equal = |shown: &dyn Fn(&Auroc) -> String, pairs: &dyn Fn(&Auroc) -> u64| {
        let mut equal = rows(shown);
        for (row, group) in equal.iter_mut().zip(&groups) {
            let of_group = columns.iter().flat_map(|column| column.1).filter(|auroc| auroc.pooled.cohort == *group);
            row.push(of_group.map(pairs).max().unwrap_or(0).to_string());
        }
        table(&equal_header, &equal)
    };
    format!(
        "## AUROC of marked segments\n\nSegments from the mark of an episode on are bad.\n\n{}\nAt equal length:\n\n{}\n\
         At equal step:\n\n{}",
        table(&header, &rows(&|auroc| plain(&auroc.pooled))),
        equal(&at_equal_length, &|auroc| auroc.pairs),
        equal(&at_equal_step, &|auroc| auroc.step_pairs)
    )
}

/// Two matrices over the scorers.
fn agreement(found: &Comparison) -> String {
    let labels: Vec<String> = found.scorers.iter().map(|scorer| scorer.label.clone()).collect();
    let header: Vec<String> = std::iter::once(String::new()).chain(labels.iter().cloned()).collect();
    let scorer = |label: &str| found.scorers.iter().find(|scorer| scorer.label == label);
    let runs = |label: &str, seed: u64| {
        scorer(label).is_some_and(|of| of.seeds.iter().any(|one| one.seed == seed && one.run.is_some()))
    };
    let reason = |one: &str, other: &str| {
        let seeds = scorer(one).map(|of| &of.seeds[..]).unwrap_or_default();
        let both = seeds.iter().any(|seed| runs(one, seed.seed) && runs(other, seed.seed));
        if both { "constant" } else { "no run" }
    };
    let matrix = |of: &dyn Fn(&Agreement) -> Option<f64>| -> String {
        let cell = |one: &String, other: &String| {
            if one == other {
                return "1".to_owned();
            }
            let same = |pair: &&Agreement| {
                (&pair.one, &pair.other) == (one, other) || (&pair.one, &pair.other) == (other, one)
            };
            value(found.agreement.iter().find(same).and_then(of), reason(one, other))
        };
        let row =
            |one: &String| std::iter::once(one.clone()).chain(labels.iter().map(|other| cell(one, other))).collect();
        table(&header, &labels.iter().map(row).collect::<Vec<Vec<String>>>())
    };
    let chance = found.top_fraction / (2.0 - found.top_fraction);
    format!(
        "## Agreement\n\nSpearman's correlation of q over all imperfect segments, under the same seed:\n\n{}\nOverlap of \
         the best parts: the segments in both, out of those in either (by chance {chance:.3}):\n\n{}",
        matrix(&|pair| pair.spearman),
        matrix(&|pair| pair.overlap)
    )
}

/// Correlation with length: a row for each group of episodes.
fn lengths(found: &Comparison) -> String {
    let header: Vec<String> = ["episodes", "number"]
        .into_iter()
        .chain(found.scorers.iter().map(|scorer| scorer.label.as_str()))
        .map(str::to_owned)
        .collect();
    let groups: &[LengthCorrelation] = found.scorers.first().map_or(&[], |scorer| &scorer.length);
    let cell = |scorer: &ScorerReport, group: &str| {
        let row = scorer.length.iter().find(|row| row.group == group);
        let none = if scorer.runs == 0 { "no run" } else { "constant" };
        value(row.and_then(|row| row.spearman), none)
    };
    let row = |group: &LengthCorrelation| {
        let cells = found.scorers.iter().map(|scorer| cell(scorer, &group.group));
        [group.group.clone(), group.episodes.to_string()].into_iter().chain(cells).collect()
    };
    format!(
        "## Correlation with length\n\nSpearman's, of an episode's mean q with its number of steps. Constant: fewer than \
         two episodes, or all alike.\n\n{}",
        table(&header, &groups.iter().map(row).collect::<Vec<Vec<String>>>())
    )
}

/// One row for each scorer and seed.
fn runs(found: &Comparison) -> String {
    let header = ["scorer", "seed", "encoder", "score run", "policy", "successes"].map(str::to_owned);
    let gap = || "-".to_owned();
    let rows = found.scorers.iter().flat_map(|scorer| {
        scorer.seeds.iter().zip(&found.encoders).map(|(seed, encoder)| {
            vec![
                scorer.label.clone(),
                seed.seed.to_string(),
                encoder.clone().unwrap_or_else(gap),
                seed.run.clone().unwrap_or_else(gap),
                seed.policy.clone().unwrap_or_else(gap),
                seed.success.map_or_else(gap, |rate| format!("{} of {}", rate.successes, rate.episodes)),
            ]
        })
    });
    format!("## Runs\n\n{}", table(&header, &rows.collect::<Vec<Vec<String>>>()))
}

#[cfg(test)]
pub(super) mod tests;
