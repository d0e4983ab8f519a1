//! `what-if`: the size of possible datasets, of given choices or of several thresholds.

use clap::Args;
use gleaner_client::Client;
use gleaner_core::proto::selection::selection_to_proto;
use gleaner_core::selection::{Rule, Selection, SelectionShape};
use gleaner_proto::v1::{
    CountKeptRequest, CountKeptResponse, GetHistogramRequest, GetHistogramResponse, Kept, KeptBySelection, KeptCount,
};
use serde_json::json;

use super::histogram::of_experts;
use super::selection::{beta_of, decimals, options, selected};
use crate::context::Context;
use crate::failure::Result;
use crate::table::Column::{Left, Right};
use crate::table::table;
use crate::{json, words};

/// The thresholds of the table that is shown without a choice, beside the default of the run.
const BETAS: [f64; 9] = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9];

#[derive(Args, Debug)]
pub(crate) struct WhatIfArgs {
    /// Id of the score run.
    run: String,
    /// Thresholds on quality, 0 to 1. Without --beta and --top: a table of thresholds, with what each keeps of imperfect
    /// episodes and the share of experts' segments above it.
    #[arg(long = "beta", value_delimiter = ',', value_name = "β,β")]
    betas: Vec<f64>,
    /// Fractions of the segments, the best ones.
    #[arg(long = "top", value_delimiter = ',', value_name = "FRACTION,FRACTION")]
    tops: Vec<f64>,
    /// Also print the counts of each episode.
    #[arg(long)]
    episodes: bool,
    #[command(flatten)]
    shape: SelectionShape,
}

impl WhatIfArgs {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let client = context.client().await?;
        let (betas, tops) = (self.betas.iter().copied(), self.tops.iter().copied());
        let rules: Vec<Rule> = betas.map(Rule::Beta).chain(tops.map(Rule::TopFraction)).collect();
        if rules.is_empty() && !self.episodes {
            return self.overview(context, &client).await;
        }
        let rules = if rules.is_empty() { BETAS.map(Rule::Beta).to_vec() } else { rules };
        let selections: Vec<Selection> = rules.into_iter().map(|rule| Selection { rule, shape: self.shape }).collect();
        let reply = self.count(&client, &selections).await?;
        context.output.result(|| json::value(&reply), || text(&reply))?;
        if let Some(&first) = selections.first() {
            context.output.next(format_args!("gleaner dataset create --run {} {}", self.run, options(first)));
        }
        Ok(())
    }

    async fn count(&self, client: &Client, selections: &[Selection]) -> Result<CountKeptResponse> {
        let request = CountKeptRequest {
            score_run_id: self.run.clone(),
            selections: selections.iter().copied().map(selection_to_proto).collect(),
            per_episode: self.episodes,
        };
        Ok(client.scores().count_kept(request).await?.into_inner())
    }

    /// What each of several thresholds keeps, beside the experts' share above it.
    async fn overview(&self, context: &Context, client: &Client) -> Result<()> {
        let default = beta_of(client, &self.run, None).await?;
        let mut betas = BETAS.to_vec();
        if !betas.contains(&default) {
            betas.push(default);
            betas.sort_by(f64::total_cmp);
        }
        let selection = |beta: &f64| Selection { rule: Rule::Beta(*beta), shape: self.shape };
        let selections: Vec<Selection> = betas.iter().map(selection).collect();
        let counts = self.count(client, &selections).await?;
        let request = GetHistogramRequest { score_run_id: self.run.clone(), bins: 20, betas };
        let histogram = client.scores().get_histogram(request).await?.into_inner();
        context.output.result(
            || Ok(json!({ "counts": json::value(&counts)?["counts"], "experts": json::value(&histogram)? })),
            || compared(&counts, &histogram, default),
        )?;
        context.output.next(format_args!("gleaner dataset create --run {} {}", self.run, options(selection(&default))));
        Ok(())
    }
}

/// A line for each threshold: imperfect episodes, and experts beside them.
fn compared(counts: &CountKeptResponse, histogram: &GetHistogramResponse, default: f64) -> String {
    let columns =
        [Right("β"), Right("SEGMENTS"), Right("SHARE"), Right("FROM EPISODES"), Right("OF EXPERTS"), Left("")];
    let row = |(count, above): (&KeptBySelection, &KeptCount)| {
        let kept = count.total.unwrap_or_default();
        let is_default = (above.beta - default).abs() < f64::EPSILON;
        [
            decimals(above.beta),
            kept.segments.to_string(),
            words::percent(kept.segments, kept.of_segments),
            format!("{} of {}", kept.episodes, kept.of_episodes),
            of_experts(histogram, above),
            if is_default { "default".to_owned() } else { String::new() },
        ]
    };
    table(columns, counts.counts.iter().zip(&histogram.kept).map(row))
}

fn text(reply: &CountKeptResponse) -> String {
    let columns =
        [Left("KEEPS"), Right("W FROM"), Left("OF"), Right("SEGMENTS"), Right("SHARE"), Right("FROM EPISODES")];
    table(columns, reply.counts.iter().flat_map(rows))
}

fn rows(count: &KeptBySelection) -> Vec<[String; 6]> {
    let row = |of: &str, kept: &Kept| {
        [
            selected(count.selection.as_ref()),
            format!("{:.4}", count.threshold),
            of.to_owned(),
            kept.segments.to_string(),
            words::percent(kept.segments, kept.of_segments),
            format!("{} of {}", kept.episodes, kept.of_episodes),
        ]
    };
    let nothing = Kept::default();
    let mut rows = vec![row("all", count.total.as_ref().unwrap_or(&nothing))];
    rows.extend(count.cohorts.iter().map(|cohort| row(&cohort.cohort, cohort.kept.as_ref().unwrap_or(&nothing))));
    rows.extend(count.episodes.iter().map(|episode| {
        let kept = Kept {
            segments: episode.segments,
            of_segments: episode.of_segments,
            episodes: u64::from(episode.segments > 0),
            of_episodes: 1,
        };
        row(&episode.episode_id, &kept)
    }));
    rows
}

#[cfg(test)]
mod tests {
    use super::*;
    use gleaner_proto::v1::{KeptOfCohort, KeptOfEpisode};

    #[test]
    fn thresholds_are_compared_with_experts_beside_imperfect_episodes() {
        let count = |segments| KeptBySelection {
            total: Some(Kept { segments, of_segments: 8, episodes: 1, of_episodes: 2 }),
            ..KeptBySelection::default()
        };
        let above = |beta, expert_segments| KeptCount { beta, expert_segments, ..KeptCount::default() };
        let counts = CountKeptResponse { counts: vec![count(6), count(2)] };
        let kept = vec![above(0.25, 4), above(0.5, 3)];
        let mut histogram = GetHistogramResponse { kept, expert_counts: vec![1, 3], ..GetHistogramResponse::default() };
        assert_eq!(
            compared(&counts, &histogram, 0.5),
            "   β  SEGMENTS   SHARE  FROM EPISODES  OF EXPERTS\n\
             0.25         6  75.0 %         1 of 2     100.0 %\n\
             0.50         2  25.0 %         1 of 2      75.0 %  default"
        );
        // An imported run has no scores of experts.
        histogram.expert_counts = vec![0, 0];
        assert!(compared(&counts, &histogram, 0.5).ends_with("-  default"));
    }

    #[test]
    fn totals_are_listed_before_cohorts_and_episodes() {
        let kept = |segments| Some(Kept { segments, of_segments: 8, episodes: 1, of_episodes: 2 });
        let reply = CountKeptResponse {
            counts: vec![KeptBySelection {
                selection: Some(selection_to_proto(Selection::top_fraction(0.25))),
                threshold: -0.5,
                total: kept(2),
                cohorts: vec![KeptOfCohort { cohort: "freeze".into(), kept: kept(1) }],
                episodes: vec![KeptOfEpisode { episode_id: "ep_1".into(), segments: 0, of_segments: 4 }],
            }],
        };
        let listed = text(&reply);
        let rows: Vec<Vec<&str>> = listed.lines().skip(1).map(|line| line.split_whitespace().collect()).collect();
        assert_eq!(rows[0], ["top", "25", "%", "-0.5000", "all", "2", "25.0", "%", "1", "of", "2"]);
        assert_eq!(rows[1][4..], ["freeze", "1", "12.5", "%", "1", "of", "2"]);
        assert_eq!(rows[2][4..], ["ep_1", "0", "0.0", "%", "0", "of", "1"]);
    }
}
