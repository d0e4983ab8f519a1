//! The course of an experiment: a server, the recordings, every job to its end, the report. Or the report of an earlier
//! run alone.

use std::ops::ControlFlow;
use std::path::Path;

use gleaner_client::Client;

use super::existing::Existing;
use super::file::Experiment;
use super::follow;
use super::gather::Gatherer;
use super::plan::planned;
use super::recordings::Recordings;
use super::report::Report;
use super::reporter::Reporter;
use super::site::Site;
use super::stage::Graph;
use super::standing::{Gap, Progress, Submitted, one_has_its_input};
use super::state::State;
use super::submit::Submitter;
use crate::connection::Reach;
use crate::context::Context;
use crate::failure::{Failure, Result};
use crate::interrupt::unless_interrupted;
use crate::own_server::{Address, ServerProcess};
use gleaner_core::{Device, Words as _};

const DATA: &str = "data";
const RECORDINGS: &str = "recordings";
const ADDRESS: &str = "server.json";
pub(super) const RESUMES: &str = "interrupted; the same command resumes from here";

/// An experiment about to be run.
pub(super) struct Course<'a> {
    pub(super) context: &'a Context,
    pub(super) experiment: &'a Experiment,
    pub(super) graph: &'a Graph,
    pub(super) out: &'a Path,
    pub(super) device: Device,
    /// As the report shows it.
    pub(super) command: String,
    /// Whether only to report the results of earlier runs.
    pub(super) only_report: bool,
}

impl Course<'_> {
    /// On a server that is started for the experiment and stopped however it ends; its data stay.
    pub(super) async fn on_own_server(&self, binary: &Path) -> Result<Report> {
        let (log, note) = (self.out.join("server.log"), self.out.join(ADDRESS));
        let data = std::path::absolute(self.out.join(DATA))?;
        if let Some((left, client)) = Address::left_behind(&note, &data).await {
            self.context.output.note(format_args!("there is a server already, at {}", left.url));
            let report = unless_interrupted(self.on(&client, Reach::open(&left.url)), RESUMES).await;
            // A run may be under way on it.
            if !self.only_report {
                left.request_stop();
            }
            return report;
        }
        if self.only_report && !data.exists() {
            return Err(self.nothing_yet());
        }
        // Without workers no job starts.
        let flags: &[&str] = if self.only_report { &["--workers", "0"] } else { &[] };
        let server = ServerProcess::start(binary, &data, &log, flags, RESUMES).await?;
        if !self.only_report {
            server.address().note(&note)?;
        }
        self.context.output.note(format_args!("server at {}, its log in {}", server.url(), log.display()));
        let url = server.url().to_owned();
        server.during(async |client| self.on(&client, Reach::open(&url)).await).await
    }

    /// On a running server.
    pub(super) async fn on(&self, client: &Client, server: Reach) -> Result<Report> {
        let Self { context, experiment, graph, device, .. } = *self;
        if self.only_report {
            let submitted = self.existing(client).await?;
            // Those of a seed that was added to the file since have no stage, and a report makes no recording.
            let recordings = self.recordings(client, |task| has_stage(graph, &submitted, task)).await?;
            return self.reporter(client, &recordings).report(&submitted).await;
        }
        let recordings = self.recordings(client, |_| true).await?;
        let mut state = State::open(self.out, self.experiment.sizes)?;
        context.output.note(planned(experiment, graph));
        let mut reporter = self.reporter(client, &recordings);
        let (mut left, mut earlier) = (graph.stages.len(), Submitted::new());
        let mut site = Site::new(context.output, server, self.out);
        loop {
            let submitter = Submitter::new(client, &mut state, &recordings, experiment, device);
            let mut submitted = submitter.after(&earlier).with(&mut site).submit(graph).await?;
            reporter.more(&submitted).await;
            // Marks with an encoder are imported once that is there, and a command evaluates one policy after the other,
            // each as soon as it is trained: other jobs run meanwhile.
            if !one_has_its_input(graph, &submitted) {
                let on_end = async |submitted: &Submitted| {
                    reporter.more(submitted).await;
                    if one_has_its_input(graph, submitted) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
                };
                follow::until(context, client, graph, &mut submitted, on_end).await?;
            }
            let waiting = submitted.iter().filter(|result| matches!(result, Err(Gap::NotYet))).count();
            if waiting == 0 || waiting == left {
                return reporter.report(&submitted).await;
            }
            (left, earlier) = (waiting, submitted);
        }
    }

    // The stages of earlier runs. If there are any, every recording exists as well.
    async fn existing(&self, client: &Client) -> Result<Submitted> {
        let state = State::open(self.out, self.experiment.sizes)?;
        let existing = Existing::on(client, &state, &self.experiment.recordings).await?;
        let submitted = existing.stages(self.graph).await?;
        if submitted.iter().all(std::result::Result::is_err) {
            return Err(self.nothing_yet());
        }
        Ok(submitted)
    }

    /// There is nothing to report.
    pub(super) fn nothing_yet(&self) -> Failure {
        let (name, out) = (&self.experiment.name, self.out.display());
        Failure::message(format!("no stage of {name} has run in {out} yet; run it without --report first"))
    }

    /// The recordings of the collections whose tasks are wanted.
    async fn recordings(&self, client: &Client, wanted: impl Fn(&str) -> bool) -> Result<Recordings> {
        let folder = |key: &str| self.out.join(RECORDINGS).join(key);
        let all = self.experiment.recordings.all().into_iter().filter(|collection| wanted(&collection.task));
        let all: Vec<_> = all.map(|collection| (collection, folder(&collection.key))).collect();
        Recordings::ready(self.context, client, &all).await
    }

    fn reporter<'a>(&'a self, client: &'a Client, recordings: &'a Recordings) -> Reporter<'a> {
        let Self { context, experiment, graph, device, .. } = *self;
        let frame = Report {
            name: experiment.name.clone(),
            task: experiment.recordings.source().task_name().to_owned(),
            command: self.command.clone(),
            device: device.as_str().to_owned(),
            cores: std::thread::available_parallelism().map_or(1, std::num::NonZero::get),
            recorded: recordings.counts(experiment.recordings.source()),
            progress: Progress::default(),
            studies: Vec::new(),
            stages: Vec::new(),
        };
        Reporter::new(context, self.out, graph, Gatherer::new(client, recordings, experiment, graph), frame)
    }
}

/// Whether a stage on the recordings of a task has been submitted.
fn has_stage(graph: &Graph, submitted: &Submitted, task: &str) -> bool {
    graph.stages.iter().zip(submitted).any(|(stage, result)| result.is_ok() && stage.task == task)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::standing::StageResult;

    #[test]
    fn a_report_needs_the_recordings_of_seeds_that_ran() {
        let file = "name = \"x\"\ntask = \"pick_cube\"\n[data]\nexperts = 3\nseed_stride = 9\n\
            cohorts = [{ agent = \"noise:1\", count = 2 }]\n[base]\nseeds = [0, 1]\n\
            [[study]]\ntable = \"scoring\"\naxes = { scorer = [\"raw\"] }\n";
        let experiment = Experiment::parse(file).unwrap();
        let graph = Graph::new(&experiment, Device::Cpu);
        let mut submitted: Submitted = graph.stages.iter().map(|_| Err(Gap::NotYet)).collect();
        submitted[0] = Ok(StageResult { id: "snap_1".into(), job: None });
        let [first, second] = [0, 1].map(|seed| experiment.recordings.of(seed).task.as_str());
        assert!(has_stage(&graph, &submitted, first) && !has_stage(&graph, &submitted, second));
    }
}
