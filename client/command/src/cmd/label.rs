//! `label`, `labels`: outcomes and cohorts, and their history.

use std::path::PathBuf;

use clap::Args;
use gleaner_client::outcome_from_word;
use gleaner_proto::v1::{Label, LabelEpisodesRequest, LabelEpisodesResponse, ListLabelsRequest, Outcome};

use super::{episodes, label_file};
use crate::context::Context;
use crate::failure::Result;
use crate::table::Column::Left;
use crate::table::table;
use crate::{json, words};

#[derive(Args, Debug)]
pub(crate) struct LabelArgs {
    /// Ids of the episodes; either all are labelled or none.
    #[arg(required_unless_present = "from")]
    ids: Vec<String>,
    /// Outcome of the attempts.
    #[arg(long, value_parser = outcome_from_word, value_name = "success|failure|unknown", required_unless_present = "from")]
    outcome: Option<Outcome>,
    /// New cohort. Default: unchanged.
    #[arg(long)]
    cohort: Option<String>,
    /// CSV file with the columns file,task,outcome,cohort, such as the labels.csv of a push, that labels stored episodes.
    /// The column file has the file name or the id of an episode; an empty cohort is unchanged.
    #[arg(long, value_name = "CSV", conflicts_with_all = ["ids", "outcome", "cohort"])]
    from: Option<PathBuf>,
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
            let labelled = (file.as_path(), self.task.as_deref(), self.reason.as_str());
            let episodes = label_file::label(context, &client, labelled).await?;
            let reply = LabelEpisodesResponse { episodes };
            context.output.result(|| json::value(&reply), || episodes::listing(&reply.episodes))?;
            context.output.next("gleaner pipeline --quick --wait");
            return Ok(());
        }
        let request = LabelEpisodesRequest {
            episode_ids: self.ids,
            outcome: self.outcome.unwrap_or_default().into(),
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
