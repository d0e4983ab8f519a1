//! `open`: one episode with its scores in a viewer that is installed here, with a layout where the Python client makes one.

use std::ffi::OsStr;
use std::io;
use std::path::{Path, PathBuf};
use std::process::{ExitStatus, Stdio};

use clap::{Args, ValueEnum};
use gleaner_client::{Client, expect_new_file};
use gleaner_proto::v1::{GetEpisodeRequest, GetEpisodeResponse};
use tokio::process::Command;

use super::newest_run::{self, Missing};
use super::selection::{beta_of, threshold};
use crate::context::Context;
use crate::failure::{Failure, Result, present};
use crate::{json, words};

/// Runs the modules of the Python client.
const PYTHON: &str = "python3";

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
        let steps = words::counted(steps, "step", "steps");
        let text = format!("{} ({steps}) in {}", self.episode, file.display());
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
                let newest = newest_run::of(client, episode).await?;
                context.output.note(newest.as_ref().map_or_else(without_scores, |run| run.note.clone()));
                newest.ok().map(|run| run.id)
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

/// The note on a recording that is opened alone, with the reason.
fn without_scores(why: &Missing) -> String {
    match why {
        Missing::NoRun => "the task has no score run yet, so the recording has no scores".to_owned(),
        Missing::Elsewhere(lack) => {
            format!("{lack}; the recording has no scores (`gleaner score` makes a new run)")
        }
    }
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

    #[test]
    fn a_recording_without_scores_has_the_reason() {
        assert!(without_scores(&Missing::NoRun).starts_with("the task has no score run yet, so"));
        let lack =
            Missing::Elsewhere("the score run of the task lacks the episode, because it was pushed later".into());
        assert!(without_scores(&lack).contains("because it was pushed later; the recording has no scores"));
    }
}
