//! `experiment`: a grid of settings from a file, run as jobs of a server, in one report.
//!
//! `file`, `collection`, `source`, `attempts`, `study`, `grid`, `method`, `cell` and `used` are the settings; `stage`
//! makes a graph of them in which no stage is done twice. `course` runs it: `recordings`, `submit`, `site` and `follow`
//! do the work, `order` has the messages, `existing`, `known` and `state` find the work of earlier runs, and `standing`
//! is the progress. `gather` and `fetch` return the results; `pool`, `interval`, `difference` and `auroc` sum them up;
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
mod existing;
mod fetch;
mod file;
mod follow;
mod gather;
mod grid;
mod interval;
mod known;
mod markdown;
mod method;
mod order;
mod plots;
mod pool;
mod rate;
mod recordings;
mod report;
mod reporter;
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
use serde_json::{Value, json};

use crate::context::Context;
use crate::failure::{Failure, Result};
use course::Course;
use file::Experiment;
use gleaner_core::{Device, Words as _};
use reporter::document;
use stage::Graph;
use standing::Progress;

#[derive(Args, Debug)]
pub(crate) struct ExperimentArgs {
    /// Path of the experiment's file (TOML).
    file: PathBuf,
    /// Folder for the recordings, the report and, without --server, the server's data; a run resumes an earlier one in
    /// the same folder. Default: the experiment's name.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Device of the jobs.
    #[arg(long, default_value = "cpu")]
    device: Device,
    /// Path of the gleaner-server binary for a temporary server. Default: the one beside this program.
    #[arg(long, value_name = "PATH")]
    server_bin: Option<PathBuf>,
    /// Folder of recordings made elsewhere, in place of `data.folder` in the file.
    #[arg(long, value_name = "DIR")]
    recordings: Option<PathBuf>,
    /// Check the file and print the stages that would run, without running any.
    #[arg(long)]
    plan: bool,
    /// Write the report of the results so far and exit, during a run or after an interrupted one.
    #[arg(long, conflicts_with = "plan")]
    report: bool,
}

impl ExperimentArgs {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let experiment = Experiment::read(&self.file, self.recordings.as_deref())?;
        let graph = Graph::new(&experiment, self.device);
        if self.plan {
            return context.output.result(|| Ok(plan(&experiment, &graph)), || planned(&experiment, &graph));
        }
        let out = self.out.clone().unwrap_or_else(|| PathBuf::from(&experiment.name));
        let command = self.command(&out);
        let (device, only_report) = (self.device, self.report);
        let course =
            Course { context, experiment: &experiment, graph: &graph, out: &out, device, command, only_report };
        if only_report && !out.exists() {
            return Err(course.nothing_yet());
        }
        std::fs::create_dir_all(&out).map_err(ClientError::io(&out))?;
        let report = if context.connection.names_server() {
            course.on(&context.client().await?, context.connection.url()).await?
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

    fn command(&self, out: &Path) -> String {
        let device = self.device.as_str().to_owned();
        let device = if self.device == Device::default() { String::new() } else { format!(" --device {device}") };
        let recordings = self.recordings.as_ref().map(|folder| format!(" --recordings {}", folder.display()));
        let recordings = recordings.unwrap_or_default();
        format!("gleaner experiment {} --out {}{recordings}{device}", self.file.display(), out.display())
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
        "tasks": experiment.recordings.all().into_iter().map(|collection| collection.task.as_str()).collect::<Vec<_>>(),
        "studies": experiment.studies.iter().map(study).collect::<Vec<_>>(),
        "stages": counts(graph).into_iter().collect::<std::collections::BTreeMap<_, _>>(),
    })
}
