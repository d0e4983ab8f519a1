//! `open`: one episode with its scores in a viewer that is installed here, with a layout where the Python client makes one.

use std::ffi::OsStr;
use std::io;
use std::path::{Path, PathBuf};
use std::process::{ExitStatus, Stdio};

use clap::{Args, ValueEnum};
use futures::{StreamExt as _, stream};
use gleaner_client::{Client, expect_new_file};
use gleaner_proto::v1::{
    Episode, GetEpisodeRequest, GetEpisodeResponse, GetEpisodeScoresRequest, ListScoreRunsRequest, Outcome, ScoreRun,
};
use tokio::process::Command;
use tonic::Code;

use super::selection::{beta_of, threshold};
use crate::context::Context;
use crate::failure::{Failure, Result, present};
use crate::{json, words};

/// Runs the modules of the Python client.
const PYTHON: &str = "python3";
/// Score runs in which an episode is looked up at once.
const LOOKUPS: usize = 4;

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Viewer {
    /// Rerun (`pip install rerun-sdk`).
    Rerun,
    /// Foxglove's desktop program.
    Foxglove,
}

#[derive(Args, Debug)]
pub(crate) struct OpenArgs {
    /// Id of the episode.
    episode: String,
    /// Viewer to open it in; its program must be on the PATH.
    #[arg(long = "in", value_enum, value_name = "VIEWER")]
    viewer: Viewer,
    /// Id of the score run. Default: the newest run of the episode's task that holds the episode; without one, the
    /// recording alone is opened.
    #[arg(long, value_name = "RUN")]
    scores: Option<String>,
    /// Threshold above which a step of the episode is marked as kept, 0 to 1. Default: that of the run.
    #[arg(long, value_parser = threshold)]
    beta: Option<f64>,
    /// New MCAP file, which remains. Default: one in a new folder for temporary files.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

impl OpenArgs {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let client = context.client().await?;
        let file = self.file()?;
        expect_new_file(&file)?;
        let reply = self.write(context, &client, &file).await?;
        let steps = reply.episode.as_ref().map_or(0, |episode| episode.steps);
        let text = format!("{} ({steps} steps) in {}", self.episode, file.display());
        context.output.result(|| json::value(&reply), || text)?;
        let layout = self.viewer.layout(context, &file).await;
        let ended = self.viewer.open(context, &file, layout.as_deref()).await;
        match ended {
            Ok(status) if status.success() => Ok(()),
            Ok(status) => {
                let problem = format!("{} failed ({status})", self.viewer.program());
                Err(Failure::message(format!("{problem}; the episode is in {}", file.display())))
            }
            Err(error) if error.kind() == io::ErrorKind::NotFound => Err(Failure::message(self.viewer.missing(&file))),
            Err(error) => Err(Failure::message(format!("{}: {error}", self.viewer.program()))),
        }
    }

    fn file(&self) -> Result<PathBuf> {
        if let Some(out) = &self.out {
            return Ok(std::path::absolute(out)?);
        }
        let folder = tempfile::Builder::new().prefix("gleaner-open-").tempdir()?;
        Ok(folder.keep().join(format!("{}.mcap", self.episode)))
    }

    /// Writes the episode with its scores, or the recording alone if no run of its task holds it.
    async fn write(&self, context: &Context, client: &Client, file: &Path) -> Result<GetEpisodeResponse> {
        let request = GetEpisodeRequest { episode_id: self.episode.clone() };
        let reply = client.episodes().get_episode(request).await?.into_inner();
        let episode = present(reply.episode.as_ref(), "an episode")?;
        let run = match &self.scores {
            Some(run) => Some(run.clone()),
            None => {
                let request = ListScoreRunsRequest { task: episode.task_id.clone() };
                let runs = client.scores().list_score_runs(request).await?.into_inner().score_runs;
                let found = newest_with(client, &runs, &episode.id).await?;
                context.output.note(chosen(episode, &runs, found));
                found.and_then(|at| runs.get(at)).map(|run| run.id.clone())
            }
        };
        match run {
            Some(run) => {
                let beta = beta_of(client, &run, self.beta).await?;
                client.export_episode(&self.episode, &run, beta, file).await?;
            }
            None => _ = client.download_episode(&self.episode, file, |_| {}).await?,
        }
        Ok(reply)
    }
}

/// The place of the first run that holds an episode.
async fn newest_with(client: &Client, runs: &[ScoreRun], episode: &str) -> Result<Option<usize>> {
    let lookup = |run: &ScoreRun| {
        let request = GetEpisodeScoresRequest { score_run_id: run.id.clone(), episode_id: episode.to_owned() };
        async move { client.scores().get_episode_scores(request).await }
    };
    let mut lookups = stream::iter(runs.iter().map(lookup)).buffered(LOOKUPS).enumerate();
    while let Some((at, scores)) = lookups.next().await {
        match scores {
            Ok(_) => return Ok(Some(at)),
            Err(status) if status.code() == Code::NotFound => {}
            Err(status) => return Err(status.into()),
        }
    }
    Ok(None)
}

/// Which run of a task an episode is opened with, or why with none. The runs are the newest first.
fn chosen(episode: &Episode, runs: &[ScoreRun], found: Option<usize>) -> String {
    match (found.and_then(|at| Some((at, runs.get(at)?))), runs) {
        (Some((0, run)), _) => format!("score run {} (the newest of the task)", run.id),
        (Some((newer, run)), _) => {
            let lack =
                if newer == 1 { "a newer one lacks it".to_owned() } else { format!("{newer} newer ones lack it") };
            format!("score run {} (the newest of the task that holds the episode; {lack})", run.id)
        }
        (None, []) => "the task has no score run yet, so the recording has no scores".to_owned(),
        (None, [newest, ..]) => {
            let lack = match runs.len() {
                1 => "the score run of the task lacks".to_owned(),
                many => format!("the {many} score runs of the task lack"),
            };
            let why = missing_because(episode, newest, runs.len() == 1);
            format!("{lack} the episode, because {why}; the recording has no scores (`gleaner score` makes a new run)")
        }
    }
}

/// `only`: whether the task has one run.
fn missing_because(episode: &Episode, newest: &ScoreRun, only: bool) -> String {
    let [pushed, scored] = [&episode.create_time, &newest.create_time].map(|time| words::timestamp(time.as_ref()));
    if pushed.zip(scored).is_some_and(|(pushed, scored)| pushed > scored) {
        return "it was pushed later".to_owned();
    }
    if episode.outcome() == Outcome::Unknown {
        return "its outcome is unknown, and snapshots by outcome leave it out".to_owned();
    }
    let snapshots = if only { "the snapshot of the run leaves" } else { "the snapshots of the runs leave" };
    format!("{snapshots} it out, or it is an expert without scores (the only one of a snapshot, or of imported scores)")
}

impl Viewer {
    /// The program that opens files.
    fn program(self) -> &'static str {
        match self {
            Self::Rerun => "rerun",
            Self::Foxglove => "foxglove-studio",
        }
    }

    /// The module of the Python client that writes a layout beside a file, with its options, and the file's ending.
    fn layout_module(self) -> (&'static str, &'static [&'static str], &'static str) {
        match self {
            Self::Rerun => ("gleaner.rerun", &["--blueprint-only"], "rbl"),
            Self::Foxglove => ("gleaner.foxglove", &[], "layout.json"),
        }
    }

    /// Writes the layout, if the Python client is installed here.
    async fn layout(self, context: &Context, file: &Path) -> Option<PathBuf> {
        let (module, options, ending) = self.layout_module();
        let layout = file.with_extension(ending);
        let words = [OsStr::new("-m"), OsStr::new(module), file.as_os_str()];
        let mut python = Command::new(PYTHON);
        // A folder named `gleaner` where the command runs is not the package.
        python.args(words).args(options).env("PYTHONSAFEPATH", "1").stdin(Stdio::null());
        let written = python.output().await.is_ok_and(|output| output.status.success()) && layout.is_file();
        if written {
            return Some(layout);
        }
        let needs = "it needs the Python client (pip install client/python of gleaner, and rerun-sdk for Rerun)";
        context.output.note(format_args!("no layout: `{PYTHON} -m {module} {}` writes it; {needs}", file.display()));
        None
    }

    /// Opens a file and waits until its program ends.
    async fn open(self, context: &Context, file: &Path, layout: Option<&Path>) -> io::Result<ExitStatus> {
        let mut viewer = Command::new(self.program());
        viewer.arg(file).stdin(Stdio::null()).stdout(Stdio::null());
        match (self, layout) {
            // Rerun takes a blueprint as a file of its own.
            (Self::Rerun, Some(layout)) => _ = viewer.arg(layout),
            (Self::Foxglove, Some(layout)) => {
                context.output.note(format_args!("layout: import {} in the menu of layouts", layout.display()));
            }
            (Self::Rerun | Self::Foxglove, None) => {}
        }
        let mut child = viewer.spawn()?;
        context.output.note(format_args!("opened in {}; the command ends when it is closed", self.program()));
        child.wait().await
    }

    /// What to do where the program is missing.
    fn missing(self, file: &Path) -> String {
        let file = file.display();
        let remedy = match self {
            Self::Rerun => format!("install it with `pip install rerun-sdk`, then run `rerun {file}`"),
            Self::Foxglove => "install Foxglove's desktop program, or open the file at app.foxglove.dev".to_owned(),
        };
        format!("`{}` is not on the PATH; the episode is in {file}: {remedy}", self.program())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn time(seconds: i64) -> Option<prost_types::Timestamp> {
        Some(prost_types::Timestamp { seconds, nanos: 0 })
    }

    #[test]
    fn the_note_names_the_run_or_why_there_is_none() {
        let run = |id: &str, seconds| ScoreRun { id: id.into(), create_time: time(seconds), ..ScoreRun::default() };
        let episode = |seconds, outcome: Outcome| Episode {
            create_time: time(seconds),
            outcome: outcome.into(),
            ..Episode::default()
        };
        let runs = [run("run_3", 30), run("run_2", 20), run("run_1", 10)];
        let failed = episode(5, Outcome::Failure);
        assert_eq!(chosen(&failed, &runs, Some(0)), "score run run_3 (the newest of the task)");
        let second = "score run run_2 (the newest of the task that holds the episode; a newer one lacks it)";
        assert_eq!(chosen(&failed, &runs, Some(1)), second);
        assert!(
            chosen(&failed, &runs, Some(2)).contains("run_1 (the newest of the task that holds the episode; 2 newer")
        );
        assert!(chosen(&failed, &[], None).starts_with("the task has no score run yet"));
        for (episode, why) in [
            (episode(40, Outcome::Failure), "because it was pushed later; the recording has no scores"),
            (episode(5, Outcome::Unknown), "because its outcome is unknown"),
            (episode(5, Outcome::Success), "it is an expert without scores"),
        ] {
            let note = chosen(&episode, &runs, None);
            assert!(note.starts_with("the 3 score runs of the task lack the episode") && note.contains(why), "{note}");
        }
        for (runs, begin) in [
            (
                &runs[..1],
                "the score run of the task lacks the episode, because the snapshot of the run leaves it out, or",
            ),
            (
                &runs[..2],
                "the 2 score runs of the task lack the episode, because the snapshots of the runs leave it out, or",
            ),
        ] {
            let note = chosen(&failed, runs, None);
            assert!(note.starts_with(begin), "{note}");
        }
    }
}
