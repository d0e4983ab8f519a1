//! `episodes`, `episode`, `download`.

use std::path::PathBuf;

use clap::Args;
use gleaner_client::{expect_new_file, outcome_from_word};
use gleaner_proto::v1::{Episode, Finding, GetEpisodeRequest, GetEpisodeResponse, ListEpisodesRequest, Outcome};

use crate::context::Context;
use crate::failure::{Result, present};
use crate::ids::every_page;
use crate::table::Column::{Left, Right};
use crate::table::{facts, table};
use crate::{json, words};

#[derive(Args, Debug)]
pub(crate) struct EpisodesArgs {
    /// Name or id of the task. Default: the only task of the server.
    #[arg(long)]
    task: Option<String>,
    /// List only episodes with this outcome.
    #[arg(long, value_parser = outcome_from_word, value_name = "success|failure|unknown")]
    outcome: Option<Outcome>,
    /// List only episodes of this cohort.
    #[arg(long, default_value = "", hide_default_value = true)]
    cohort: String,
    /// List the trash instead.
    #[arg(long)]
    deleted: bool,
}

impl EpisodesArgs {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let client = context.client().await?;
        let request = ListEpisodesRequest {
            task: context.task(&client, self.task.as_deref()).await?,
            outcome: self.outcome.unwrap_or_default().into(),
            cohort: self.cohort,
            page_size: 1000,
            page_token: String::new(),
            deleted: self.deleted,
        };
        let reply = every_page(&client, request).await?;
        context.output.result(|| json::value(&reply), || listing(&reply.episodes))?;
        match reply.episodes.first() {
            Some(episode) if self.deleted => context.output.next(format_args!("gleaner restore {}", episode.id)),
            Some(episode) => context.output.next(format_args!("gleaner episode {}", episode.id)),
            None if self.deleted => {}
            None => context.output.next("gleaner push RECORDINGS --labels labels.csv"),
        }
        Ok(())
    }
}

/// Episodes as a table.
pub(crate) fn listing(episodes: &[Episode]) -> String {
    let columns = [
        Left("ID"),
        Left("OUTCOME"),
        Left("COHORT"),
        Right("STEPS"),
        Right("SECONDS"),
        Right("MB"),
        Right("WARNINGS"),
        Left("FILE"),
    ];
    let row = |episode: &Episode| {
        [
            episode.id.clone(),
            words::outcome(episode.outcome()),
            episode.cohort.clone(),
            episode.steps.to_string(),
            format!("{:.1}", episode.duration_s),
            format!("{:.2}", words::megabytes(episode.size_bytes)),
            episode.warnings.to_string(),
            episode.file_name.clone(),
        ]
    };
    table(columns, episodes.iter().map(row))
}

#[derive(Args, Debug)]
pub(crate) struct EpisodeArgs {
    /// Id of the episode, or the file name of its recording.
    id: String,
}

impl EpisodeArgs {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let request = GetEpisodeRequest { episode_id: self.id };
        let reply = context.client().await?.episodes().get_episode(request).await?.into_inner();
        let episode = present(reply.episode.as_ref(), "an episode")?;
        context.output.result(|| json::value(&reply), || describe(episode, &reply))?;
        context.output.next(format_args!("gleaner label {} --outcome success|failure", episode.id));
        Ok(())
    }
}

fn describe(episode: &Episode, reply: &GetEpisodeResponse) -> String {
    let report = reply.report.clone().unwrap_or_default();
    let mut text = facts([
        ("id", episode.id.clone()),
        ("file", episode.file_name.clone()),
        ("outcome", words::outcome(episode.outcome())),
        ("cohort", episode.cohort.clone()),
        ("steps", format!("{} in {:.2} s, {:.2} Hz", episode.steps, episode.duration_s, report.rate_hz)),
        ("mapping", episode.mapping.clone()),
        ("size", format!("{:.2} MB, {} messages", words::megabytes(episode.size_bytes), report.messages)),
        ("blake3", episode.blake3.clone()),
        ("pushed", words::moment(episode.create_time.as_ref())),
    ]);
    if episode.delete_time.is_some() {
        text.push_str(&format!("\nin the trash since {}", words::moment(episode.delete_time.as_ref())));
    }
    text.push('\n');
    text.push_str(&findings(&report.findings));
    text
}

fn findings(findings: &[Finding]) -> String {
    if findings.is_empty() {
        return "no findings".into();
    }
    let columns = [Left("SEVERITY"), Left("FINDING"), Left("ABOUT"), Right("FROM STEP"), Left("DETAIL")];
    let row = |finding: &Finding| {
        [
            words::severity(finding.severity()),
            finding.code.clone(),
            finding.subject.clone(),
            finding.first_step.map(|step| step.to_string()).unwrap_or_default(),
            finding.detail.clone(),
        ]
    };
    table(columns, findings.iter().map(row))
}

#[derive(Args, Debug)]
pub(crate) struct DownloadArgs {
    /// Id of the episode, or the file name of its recording.
    id: String,
    /// New file to write.
    #[arg(short, long, alias = "output", value_name = "FILE")]
    out: PathBuf,
}

impl DownloadArgs {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        expect_new_file(&self.out)?;
        let client = context.client().await?;
        let bar = context.progress.spinner("download");
        let episode = client.download_episode(&self.id, &self.out, |bytes| bar.set_position(bytes)).await?;
        bar.finish_and_clear();
        context.output.result(
            || json::value(&episode),
            || format!("{} ({:.2} MB, verified)", self.out.display(), words::megabytes(episode.size_bytes)),
        )?;
        context.output.next(format_args!("gleaner episode {}", episode.id));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser as _;

    use crate::cli::Cli;
    use crate::context::Context;
    use crate::output::Output;

    #[tokio::test]
    async fn a_download_does_not_replace_a_file() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("notes.txt");
        std::fs::write(&file, "mine").unwrap();
        let words = ["gleaner", "--server", "http://127.0.0.1:9", "download", "ep_1", "--out", file.to_str().unwrap()];
        let cli = Cli::try_parse_from(words).unwrap();
        let context = Context::new(cli.connection, Output::new(false));
        let message = cli.command.run(&context).await.unwrap_err().to_string();
        assert!(message.contains("notes.txt exists; give another name"), "{message}");
        assert_eq!(std::fs::read(&file).unwrap(), b"mine");
    }
}
