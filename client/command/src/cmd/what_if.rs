//! `what-if`: the size of possible datasets.

use clap::Args;
use gleaner_core::proto::selection::selection_to_proto;
use gleaner_core::selection::{Rule, Selection, SelectionShape};
use gleaner_proto::v1::{CountKeptRequest, CountKeptResponse, Kept, KeptBySelection};

use super::selection::{options, selected};
use crate::context::Context;
use crate::failure::Result;
use crate::table::Column::{Left, Right};
use crate::table::table;
use crate::{json, words};

#[derive(Args, Debug)]
pub(crate) struct WhatIfArgs {
    /// Id of the score run.
    run: String,
    /// Thresholds on quality, 0 to 1.
    #[arg(long = "beta", value_delimiter = ',', value_name = "β,β", required_unless_present = "tops")]
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
        let (betas, tops) = (self.betas.iter().copied(), self.tops.iter().copied());
        let rules = betas.map(Rule::Beta).chain(tops.map(Rule::TopFraction));
        let selections: Vec<Selection> = rules.map(|rule| Selection { rule, shape: self.shape }).collect();
        let request = CountKeptRequest {
            score_run_id: self.run.clone(),
            selections: selections.iter().copied().map(selection_to_proto).collect(),
            per_episode: self.episodes,
        };
        let reply = context.client().await?.scores().count_kept(request).await?.into_inner();
        context.output.result(|| json::value(&reply), || text(&reply))?;
        if let Some(&first) = selections.first() {
            context.output.next(format_args!("gleaner dataset create --run {} {}", self.run, options(first)));
        }
        Ok(())
    }
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
