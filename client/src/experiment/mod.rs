//! `experiment`: a grid of settings from a file, run as jobs of a server, in one report.
//!
//! `file`, `study`, `grid` and `cell` are what is asked for; `stage` makes of it a graph in which nothing is done twice;
//! `recordings`, `submit` and `follow` have it done, and `existing` looks up what was; `standing` says how far it is,
//! `gather` fetches what was found, `pool` sums it up, and `report`, `markdown`, `tables`, `plots` and `reporter` say it.

mod cell;
mod existing;
mod file;
mod follow;
mod gather;
mod grid;
mod markdown;
mod order;
mod plots;
mod pool;
mod recordings;
mod report;
mod reporter;
mod stage;
mod standing;
mod state;
mod study;
mod submit;
mod tables;

use std::path::{Path, PathBuf};

use clap::Args;
use clap::ValueEnum as _;
use gleaner_client::{Client, ClientError};
use serde_json::{Value, json};

use crate::choice::DeviceWord;
use crate::context::Context;
use crate::failure::{Failure, Result};
use crate::own_server::{Address, ServerProcess};
use existing::Existing;
use file::Experiment;
use gather::Gatherer;
use recordings::Recordings;
use report::Report;
use reporter::{Reporter, document};
use stage::Graph;
use standing::Progress;
use state::State;
use submit::{Submitted, Submitter};

const DATA: &str = "data";
const RECORDINGS: &str = "recordings";
const ADDRESS: &str = "server.json";

#[derive(Args, Debug)]
pub(crate) struct ExperimentArgs {
    /// The experiment, as TOML.
    file: PathBuf,
    /// Where the recordings, the report and, without --server, the server's data go; by default the experiment's
    /// name. What an earlier run left there is gone on from.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Where jobs compute.
    #[arg(long, value_enum, default_value = "cpu")]
    device: DeviceWord,
    /// The gleaner-server binary, for a server of the experiment's own; by default the one beside this program.
    #[arg(long, value_name = "PATH")]
    server_bin: Option<PathBuf>,
    /// Only check the file and say what would be run.
    #[arg(long)]
    plan: bool,
    /// Only write the report of what is there now, beside a run that is under way or after one that was stopped.
    #[arg(long, conflicts_with = "plan")]
    report: bool,
}

impl ExperimentArgs {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let experiment = Experiment::read(&self.file)?;
        let graph = Graph::new(&experiment, self.device);
        if self.plan {
            return context.output.result(|| Ok(plan(&experiment, &graph)), || planned(&experiment, &graph));
        }
        let out = self.out.clone().unwrap_or_else(|| PathBuf::from(&experiment.name));
        let command = self.command(&out);
        let (device, only_report) = (self.device, self.report);
        let work = Work { context, experiment: &experiment, graph: &graph, out: &out, device, command, only_report };
        if only_report && !out.exists() {
            return Err(work.nothing_yet());
        }
        std::fs::create_dir_all(&out).map_err(ClientError::io(&out))?;
        let report = if context.names_server() {
            work.on(&context.client().await?).await?
        } else {
            work.on_own_server(&self.server_bin()?).await?
        };
        context.output.result(|| document(&report), || markdown::markdown(&report))?;
        context.output.next(format_args!("open {}", out.join("report.md").display()));
        let Progress { cells, complete, .. } = report.progress;
        if only_report || complete == cells {
            return Ok(());
        }
        Err(Failure::told(format!(
            "{} of {cells} cells are not complete; {} says why, and the same command tries them again",
            cells - complete,
            out.join("report.md").display()
        )))
    }

    fn command(&self, out: &Path) -> String {
        let device = self.device.to_possible_value().map(|word| word.get_name().to_owned()).unwrap_or_default();
        let device = if self.device == DeviceWord::default() { String::new() } else { format!(" --device {device}") };
        format!("gleaner experiment {} --out {}{device}", self.file.display(), out.display())
    }

    fn server_bin(&self) -> Result<PathBuf> {
        if let Some(path) = &self.server_bin {
            return Ok(path.clone());
        }
        let beside = std::env::current_exe()?.with_file_name("gleaner-server");
        if beside.is_file() {
            return Ok(beside);
        }
        Err(Failure::told(format!(
            "{} is not there; name the server's binary with --server-bin, or a running server with --server",
            beside.display()
        )))
    }
}

/// An experiment about to be run.
struct Work<'a> {
    context: &'a Context,
    experiment: &'a Experiment,
    graph: &'a Graph,
    out: &'a Path,
    device: DeviceWord,
    /// As the report shows it.
    command: String,
    only_report: bool,
}

impl Work<'_> {
    // On a server that is started for it and stopped however it ends; its data stay.
    async fn on_own_server(&self, binary: &Path) -> Result<Report> {
        let (log, note) = (self.out.join("server.log"), self.out.join(ADDRESS));
        if let Some((left, client)) = Address::left_behind(&note).await {
            self.context.output.note(format_args!("there is a server already, at {}", left.url));
            let report = self.unless_interrupted(&client).await;
            // A run may be under way on it.
            if !self.only_report {
                left.ask_to_stop();
            }
            return report;
        }
        let data = self.out.join(DATA);
        if self.only_report && !data.exists() {
            return Err(self.nothing_yet());
        }
        // Without workers jobs wait where they are.
        let flags: &[&str] = if self.only_report { &["--workers", "0"] } else { &[] };
        let server = ServerProcess::start(binary, &data, &log, flags).await?;
        if !self.only_report {
            server.address().note(&note)?;
        }
        self.context.output.note(format_args!("server at {}, its log in {}", server.url(), log.display()));
        let report = match Client::connect(server.url(), None).await {
            Ok(client) => self.unless_interrupted(&client).await,
            Err(error) => Err(error.into()),
        };
        let stopped = server.stop().await;
        let report = report?;
        stopped.map(|()| report)
    }

    async fn unless_interrupted(&self, client: &Client) -> Result<Report> {
        tokio::select! {
            report = self.on(client) => report,
            () = interrupted() => Err(Failure::told("interrupted; the same command goes on from here")),
        }
    }

    async fn on(&self, client: &Client) -> Result<Report> {
        let Self { context, experiment, graph, device, .. } = *self;
        if self.only_report {
            let submitted = self.existing(client).await?;
            let recordings = self.recordings(client).await?;
            return self.reporter(client, &recordings).report(&submitted).await;
        }
        let recordings = self.recordings(client).await?;
        let mut state = State::open(self.out)?;
        let mut submitted = Submitter::new(client, &mut state, experiment, device).submit(graph).await?;
        context.output.note(planned(experiment, graph));
        let mut reporter = self.reporter(client, &recordings);
        reporter.more(&submitted).await;
        let on_end = async |submitted: &Submitted| reporter.more(submitted).await;
        follow::to_the_end(context, client, graph, &mut submitted, on_end).await?;
        reporter.report(&submitted).await
    }

    // What is there already, if there is anything: then the recordings are all there as well.
    async fn existing(&self, client: &Client) -> Result<Submitted> {
        let state = State::open(self.out)?;
        let existing = Existing::on(client, &state, &self.experiment.task()).await?;
        let submitted = existing.stages(self.graph).await?;
        if submitted.iter().all(std::result::Result::is_err) {
            return Err(self.nothing_yet());
        }
        Ok(submitted)
    }

    fn nothing_yet(&self) -> Failure {
        let (name, out) = (&self.experiment.name, self.out.display());
        Failure::told(format!("nothing of {name} has been run in {out} yet; run it without --report first"))
    }

    async fn recordings(&self, client: &Client) -> Result<Recordings> {
        Recordings::ready(self.context, client, &self.out.join(RECORDINGS), self.experiment).await
    }

    fn reporter<'a>(&'a self, client: &'a Client, recordings: &'a Recordings) -> Reporter<'a> {
        let Self { context, experiment, graph, device, .. } = *self;
        let frame = Report {
            name: experiment.name.clone(),
            task: experiment.recordings.task.to_string(),
            command: self.command.clone(),
            device: device.to_possible_value().map(|word| word.get_name().to_owned()).unwrap_or_default(),
            cores: std::thread::available_parallelism().map_or(1, std::num::NonZero::get),
            recorded: recordings.counts(experiment),
            progress: Progress::default(),
            studies: Vec::new(),
            stages: Vec::new(),
        };
        Reporter::new(context, self.out, graph, Gatherer::new(client, recordings, experiment, graph), frame)
    }
}

// Asked to stop, from the keyboard or by the system.
async fn interrupted() {
    use tokio::signal::unix::{SignalKind, signal};
    let Ok(mut terminate) = signal(SignalKind::terminate()) else {
        let _ = tokio::signal::ctrl_c().await;
        return;
    };
    tokio::select! {
        _ = tokio::signal::ctrl_c() => {}
        _ = terminate.recv() => {}
    }
}

fn counts(graph: &Graph) -> Vec<(&'static str, usize)> {
    let mut counts: Vec<(&'static str, usize)> = Vec::new();
    for stage in &graph.stages {
        let kind = stage.work.kind();
        match counts.iter_mut().find(|count| count.0 == kind) {
            Some(count) => count.1 += 1,
            None => counts.push((kind, 1)),
        }
    }
    counts
}

fn planned(experiment: &Experiment, graph: &Graph) -> String {
    let cells: usize = experiment.studies.iter().map(|study| study.cells.len()).sum();
    let stages: Vec<String> = counts(graph).iter().map(|(kind, count)| format!("{count} {kind}")).collect();
    format!(
        "{}: {} studies, {cells} cells; {} stages: {}",
        experiment.name,
        experiment.studies.len(),
        graph.stages.len(),
        stages.join(", ")
    )
}

fn plan(experiment: &Experiment, graph: &Graph) -> Value {
    let study = |study: &file::Study| {
        json!({
            "name": study.name,
            "cells": study.cells.iter().map(|cell| cell.label.as_str()).collect::<Vec<_>>(),
        })
    };
    json!({
        "name": experiment.name,
        "task": experiment.task(),
        "studies": experiment.studies.iter().map(study).collect::<Vec<_>>(),
        "stages": counts(graph).into_iter().collect::<std::collections::BTreeMap<_, _>>(),
    })
}
