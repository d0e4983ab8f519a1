//! `label`, `labels`: outcomes and cohorts, and their history.

use std::path::PathBuf;

use clap::Args;
use gleaner_client::outcome_from_word;
use gleaner_proto::v1::{Label, LabelEpisodesRequest, LabelEpisodesResponse, Outcome};

use super::{episodes, label_file, label_table::LabelTableArgs};
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
        let request = LabelEpisodesRequest {
            episode_ids: self.ids,
            outcome: self.outcome.unwrap_or_default().into(),
            cohort: self.cohort,
            author: context.connection.author(),
            reason: self.reason,
        };
        let reply = client.episodes().label_episodes(request).await?.into_inner();
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

    use crate::cli::Cli;

    #[test]
    fn a_label_has_an_outcome_or_a_cohort() {
        let parsed = |line: &str| Cli::try_parse_from(line.split(' '));
        assert!(parsed("gleaner label ep_1 ep_2 --cohort dropped").is_ok());
        assert!(parsed("gleaner label ep_1").unwrap_err().to_string().contains("--outcome"));
    }
}
