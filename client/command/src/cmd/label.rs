//! `label`, `labels`: outcomes and cohorts, and their history.

use std::collections::BTreeMap;
use std::path::PathBuf;

use clap::Args;
use gleaner_client::{Client, outcome_from_word};
use gleaner_proto::v1::{Episode, GetEpisodeRequest, Label, LabelEpisodesRequest, LabelEpisodesResponse, Outcome};

use super::{episodes, label_file, label_table::LabelTableArgs};
use crate::context::Context;
use crate::failure::{Failure, Result, present};
use crate::table::Column::Left;
use crate::table::table;
use crate::{json, words};

#[derive(Args, Debug)]
pub(crate) struct LabelArgs {
    /// Ids of the episodes; either all are labelled or none; without --outcome, all of one outcome or none of them.
    #[arg(required_unless_present = "from")]
    ids: Vec<String>,
    /// Outcome of the attempts. Default with --cohort: unchanged.
    #[arg(long, value_parser = outcome_from_word, value_name = "success|failure|unknown", required_unless_present_any = ["from", "cohort"])]
    outcome: Option<Outcome>,
    /// New cohort, such as the kind of a failure, which charts and counts show apart. Default: unchanged.
    #[arg(long)]
    cohort: Option<String>,
    /// CSV file with the columns file,task,outcome,cohort, such as the labels.csv of a push, that labels stored episodes.
    /// The column file has the file name or the id of an episode; an empty cohort is unchanged.
    #[arg(long, value_name = "CSV", conflicts_with_all = ["ids", "outcome", "cohort"])]
    from: Option<PathBuf>,
    #[command(flatten)]
    table: LabelTableArgs,
    /// Name or id of the task of the rows of --from without one; no row may have another. Default: the only task of the
    /// server.
    #[arg(long, requires = "from")]
    task: Option<String>,
    /// Reason, kept in the history.
    #[arg(long, default_value = "", hide_default_value = true)]
    reason: String,
}

impl LabelArgs {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        if let Some(file) = &self.from {
            let client = context.client().await?;
            let history = (self.task.as_deref(), self.reason.as_str());
            let episodes = label_file::label(context, &client, (file, &self.table), history).await?;
            let reply = LabelEpisodesResponse { episodes };
            context.output.result(|| json::value(&reply), || episodes::listing(&reply.episodes))?;
            context.output.next("gleaner pipeline --quick --wait");
            return Ok(());
        }
        self.table.refuse("--from")?;
        let client = context.client().await?;
        let labels = match self.outcome {
            Some(outcome) => BTreeMap::from([(outcome.into(), self.ids.clone())]),
            None => by_outcome(&episodes_of(&client, &self.ids).await?)?,
        };
        let mut reply = LabelEpisodesResponse::default();
        for (outcome, episode_ids) in labels {
            let request = LabelEpisodesRequest {
                episode_ids,
                outcome,
                cohort: self.cohort.clone(),
                author: context.connection.author(),
                reason: self.reason.clone(),
            };
            reply.episodes.extend(client.episodes().label_episodes(request).await?.into_inner().episodes);
        }
        context.output.result(|| json::value(&reply), || episodes::listing(&reply.episodes))?;
        if let Some(episode) = reply.episodes.first() {
            context.output.next(format_args!("gleaner labels {} (the history of its labels)", episode.id));
        }
        Ok(())
    }
}

async fn episodes_of(client: &Client, ids: &[String]) -> Result<Vec<Episode>> {
    let mut found = Vec::with_capacity(ids.len());
    for id in ids {
        let request = GetEpisodeRequest { episode_id: id.clone() };
        let reply = client.episodes().get_episode(request).await?.into_inner();
        found.push(present(reply.episode, "an episode")?);
    }
    Ok(found)
}

/// The ids of episodes for each outcome that they have: a label states its outcome, also one that keeps it.
fn by_outcome(episodes: &[Episode]) -> Result<BTreeMap<i32, Vec<String>>> {
    let mut found: BTreeMap<i32, Vec<String>> = BTreeMap::new();
    for episode in episodes {
        // Here, because the labels of another outcome would be changed before the server refuses it.
        if episode.delete_time.is_some() {
            let problem = format!("{} is in the trash; no label was changed: restore it, or leave it out", episode.id);
            return Err(Failure::message(problem));
        }
        found.entry(episode.outcome).or_default().push(episode.id.clone());
    }
    Ok(found)
}

#[derive(Args, Debug)]
pub(crate) struct LabelsArgs {
    /// Id of the episode.
    id: String,
}

impl LabelsArgs {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let reply = context.client().await?.every_label(&self.id).await?;
        let columns = [Left("WHEN"), Left("WHO"), Left("OUTCOME"), Left("COHORT"), Left("WHY")];
        let row = |label: &Label| {
            [
                words::moment(label.create_time.as_ref()),
                label.author.clone(),
                words::outcome(label.outcome()),
                label.cohort.clone(),
                label.reason.clone(),
            ]
        };
        context.output.result(|| json::value(&reply), || table(columns, reply.labels.iter().map(row)))?;
        context.output.next(format_args!("gleaner label {} --outcome success|failure --reason WHY", self.id));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser as _;

    use super::*;
    use crate::cli::Cli;

    #[test]
    fn a_cohort_alone_keeps_the_outcome_of_each_episode() {
        let parsed = |line: &str| Cli::try_parse_from(line.split(' '));
        assert!(parsed("gleaner label ep_1 ep_2 --cohort dropped").is_ok());
        assert!(parsed("gleaner label ep_1").unwrap_err().to_string().contains("--outcome"));
        let episode =
            |id: &str, outcome: Outcome| Episode { id: id.into(), outcome: outcome.into(), ..Episode::default() };
        let (failure, success) = (Outcome::Failure, Outcome::Success);
        let episodes = [episode("ep_1", failure), episode("ep_2", success), episode("ep_3", failure)];
        let ids = |ids: &[&str]| ids.iter().map(|&id| id.to_owned()).collect::<Vec<_>>();
        let expected = [(failure.into(), ids(&["ep_1", "ep_3"])), (success.into(), ids(&["ep_2"]))];
        assert_eq!(by_outcome(&episodes).unwrap(), BTreeMap::from(expected));
    }

    #[test]
    fn a_deleted_episode_is_refused_before_the_first_label() {
        let delete_time = Some(prost_types::Timestamp::default());
        let episodes = [Episode::default(), Episode { id: "ep_2".into(), delete_time, ..Episode::default() }];
        let refused = by_outcome(&episodes).unwrap_err().to_string();
        assert!(refused.starts_with("ep_2 is in the trash; no label was changed"), "{refused}");
    }
}
