//! `label`, `labels`: outcomes and cohorts, and their history.

use clap::Args;
use gleaner_client::outcome_from_word;
use gleaner_proto::v1::{Label, LabelEpisodesRequest, ListLabelsRequest, Outcome};

use super::episodes;
use crate::context::Context;
use crate::failure::Result;
use crate::table::Column::Left;
use crate::table::table;
use crate::{json, words};

#[derive(Args, Debug)]
pub(crate) struct LabelArgs {
    /// Ids of the episodes; either all are labelled or none.
    #[arg(required = true)]
    ids: Vec<String>,
    /// Outcome of the attempts.
    #[arg(long, value_parser = outcome_from_word, value_name = "success|failure|unknown")]
    outcome: Outcome,
    /// New cohort. Default: unchanged.
    #[arg(long)]
    cohort: Option<String>,
    /// Reason, kept in the history.
    #[arg(long, default_value = "", hide_default_value = true)]
    reason: String,
}

impl LabelArgs {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let request = LabelEpisodesRequest {
            episode_ids: self.ids,
            outcome: self.outcome.into(),
            cohort: self.cohort,
            author: context.connection.author(),
            reason: self.reason,
        };
        let reply = context.client().await?.episodes().label_episodes(request).await?.into_inner();
        context.output.result(|| json::value(&reply), || episodes::listing(&reply.episodes))?;
        if let Some(episode) = reply.episodes.first() {
            context.output.next(format_args!("gleaner labels {} (the history of its labels)", episode.id));
        }
        Ok(())
    }
}

#[derive(Args, Debug)]
pub(crate) struct LabelsArgs {
    /// Id of the episode.
    id: String,
}

impl LabelsArgs {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let request = ListLabelsRequest { episode_id: self.id.clone() };
        let reply = context.client().await?.episodes().list_labels(request).await?.into_inner();
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
