//! `experiment`: a grid of settings from a file, run as jobs of a server, in one report.
//!
//! `file`, `scale`, `collection`, `source`, `attempts`, `study`, `grid`, `method`, `cell` and `used` are the settings;
//! `stage` makes a graph of them in which no stage is done twice, and `plan` shows it. `course` runs it: `recordings`
//! (with `mark_rows`), `submit`, `site` and `follow` do the work, `order` has the messages, `existing`, `known` and
//! `state` find the work of earlier runs, and `standing` is the progress. `gather` and `fetch` return the results; `pool`,
//! `interval`, `difference` and `auroc` sum them up;
//! `report`, `markdown`, `tables`, `plots` and `reporter` show them.
//! `demo` is a preset with a report of its own, and `compare` runs stages on a snapshot or encoders that exist.

mod attempts;
mod auroc;
mod cell;
mod collection;
pub(crate) mod compare;
mod course;
pub(crate) mod demo;
mod difference;
mod escape;
mod existing;
mod fetch;
mod file;
mod follow;
mod gather;
mod grid;
mod interval;
mod known;
mod mark_rows;
mod markdown;
mod method;
mod order;
mod plan;
mod plots;
mod pool;
mod rate;
mod recordings;
mod report;
mod reporter;
mod scale;
mod scorings;
mod site;
mod source;
mod stage;
mod standing;
mod state;
mod study;
mod submit;
mod tables;
mod used;

use std::path::{Path, PathBuf};

use clap::Args;
use gleaner_client::ClientError;

use crate::context::Context;
use crate::failure::{Failure, Result};
use crate::interrupt::unless_interrupted;
use crate::words;
use course::Course;
use file::Experiment;
use gleaner_core::{Device, Words as _};
use reporter::document;
use scale::Sizes;
use stage::Graph;
use standing::Progress;
use state::State;

#[derive(Args, Debug)]
pub(crate) struct ExperimentArgs {
    /// Path of the experiment's file (TOML).
    file: PathBuf,
    /// Folder for the recordings, the report and, without --server, the server's data; a run resumes an earlier one in
    /// the same folder. Default: the experiment's name, with --scale followed by `_scaled`.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Device of the jobs. Default: cpu, or with --scale the one that the file's table `scale` names.
    #[arg(long)]
    device: Option<Device>,
    /// Use the sizes of the file's table `scale`, which are for a larger machine: preset, steps, batch, seeds,
    /// episodes and others in place of those of `base` and `data`. A folder holds the results of runs with the flag or
    /// of runs without it.
    #[arg(long)]
    scale: bool,
    /// Path of the gleaner-server binary for a temporary server. Default: the one beside this program.
    #[arg(long, value_name = "PATH")]
    server_bin: Option<PathBuf>,
    /// Folder of recordings made elsewhere, in place of `data.folder` in the file.
    #[arg(long, value_name = "DIR")]
    recordings: Option<PathBuf>,
    /// Check the file and print the stages that would run with their sizes, without running any.
    #[arg(long)]
    plan: bool,
    /// Write the report of the results so far and exit, during a run or after an interrupted one.
    #[arg(long, conflicts_with = "plan")]
    report: bool,
}

impl ExperimentArgs {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let experiment = Experiment::read(&self.file, self.recordings.as_deref(), Sizes::of_flag(self.scale))?;
        let device = self.device.unwrap_or(experiment.device);
        let graph = Graph::new(&experiment, device);
        if self.plan {
            return context.output.result(
                || Ok(plan::document(&experiment, &graph, device)),
                || plan::text(&experiment, &graph, device),
            );
        }
        let out = self.out(&experiment);
        let command = self.command(&experiment, &out);
        let only_report = self.report;
        let course =
            Course { context, experiment: &experiment, graph: &graph, out: &out, device, command, only_report };
        // Before a server starts, or a running one of other sizes is found.
        let state = State::open(&out, experiment.sizes)?;
        if only_report && !out.exists() {
            return Err(course.nothing_yet());
        }
        std::fs::create_dir_all(&out).map_err(ClientError::io(&out))?;
        let _held = if only_report { None } else { Some(state::hold(&out)?) };
        if !only_report {
            state.begin()?;
        }
        let report = if context.connection.names_server() {
            let client = context.client().await?;
            // So that a command that evaluates ends with this one.
            unless_interrupted(course.on(&client, context.connection.reach()), course::RESUMES).await?
        } else {
            course.on_own_server(&self.server_bin()?).await?
        };
        context.output.result(|| document(&report), || markdown::markdown(&report))?;
        context.output.next(format_args!("open {}", out.join("report.md").display()));
        let Progress { cells, complete, .. } = report.progress;
        if only_report || complete == cells {
            return Ok(());
        }
        Err(Failure::message(format!(
            "{} of {cells} cells are not complete; {} has the reasons, and the same command retries them",
            cells - complete,
            out.join("report.md").display()
        )))
    }

    fn out(&self, experiment: &Experiment) -> PathBuf {
        let suffix = if self.scale { "_scaled" } else { "" };
        self.out.clone().unwrap_or_else(|| PathBuf::from(format!("{}{suffix}", experiment.name)))
    }

    /// The command that makes the report, without the flags that change no result.
    fn command(&self, experiment: &Experiment, out: &Path) -> String {
        let device = self.device.filter(|device| *device != experiment.device);
        let device = device.map(|device| format!(" --device {}", device.as_str())).unwrap_or_default();
        let path = |path: &Path| words::shell_word(&path.display().to_string());
        let recordings = self.recordings.as_ref().map(|folder| format!(" --recordings {}", path(folder)));
        let recordings = recordings.unwrap_or_default();
        let scale = if self.scale { " --scale" } else { "" };
        format!("gleaner experiment {}{scale} --out {}{recordings}{device}", path(&self.file), path(out))
    }

    fn server_bin(&self) -> Result<PathBuf> {
        if let Some(path) = &self.server_bin {
            return Ok(path.clone());
        }
        let beside = std::env::current_exe()?.with_file_name("gleaner-server");
        if beside.is_file() {
            return Ok(beside);
        }
        Err(Failure::message(format!(
            "{} does not exist; name the server's binary with --server-bin, or a running server with --server",
            beside.display()
        )))
    }
}

#[cfg(test)]
mod tests;
