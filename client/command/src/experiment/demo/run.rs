//! The course of the demo: its experiment's recordings and jobs, then both policies over the endpoint that robots use.

use std::path::Path;
use std::time::{Duration, Instant};

use gleaner_client::{Client, DrivePlan};
use gleaner_core::Device;
use gleaner_core::proto::score::expert_ranking;
use gleaner_core::selection::Selection;
use gleaner_proto::v1::{DeployRequest, GetDatasetRequest, GetHistogramRequest, GetHistogramResponse, Job};

use super::super::follow::{seconds, to_the_end};
use super::super::gather::{Gatherer, by_cohort};
use super::super::recordings::{Recordings, recorded};
use super::super::stage::{Chain, Graph};
use super::super::standing::{StageResult, Standing, Submitted, stage_result, standing};
use super::super::state::State;
use super::super::submit::Submitter;
use super::plan::Plan;
use super::report::{Evaluation, Report, Stage, Threshold};
use crate::cmd::{drive, histogram};
use crate::context::Context;
use crate::failure::{Failure, Result, present};
use crate::output::terminal_width;
use crate::quality::{MarkedEpisode, select, separations};
use crate::words;

/// The results of the demo.
pub(super) struct Found {
    pub(super) report: Report,
    pub(super) episodes: Vec<MarkedEpisode>,
}

/// The demo under way.
pub(super) struct Run<'a> {
    context: &'a Context,
    client: &'a Client,
    plan: &'a Plan,
    graph: Graph,
    times: Vec<Stage>,
}

impl<'a> Run<'a> {
    pub(super) fn new(context: &'a Context, client: &'a Client, plan: &'a Plan) -> Self {
        let graph = Graph::without_evaluations(&plan.experiment, Device::default());
        Self { context, client, plan, graph, times: Vec::new() }
    }

    /// Every stage; recordings go to this folder.
    pub(super) async fn run(mut self, folder: &Path) -> Result<Found> {
        let began = Instant::now();
        let experiment = &self.plan.experiment;
        let recordings = self.recordings(folder).await?;
        let submitted = self.jobs(folder, &recordings).await?;
        let [base, gleaned] = self.chains()?;
        let run = self.result_of(&submitted, &gleaned, "score")?.id.clone();
        let reply = self.histogram(&run).await?;
        let ranking = expert_ranking(&reply);
        let warnings = ranking.warnings(0.0);
        let GetHistogramResponse { counts: histogram, expert_counts: experts, cohort_counts, .. } = reply;
        let comparing = Instant::now();
        let episodes = Gatherer::new(self.client, &recordings, experiment, &self.graph).episodes(&run).await?;
        self.done("compare with mark", comparing.elapsed(), format!("{} imperfect episodes", episodes.len()));
        self.time_jobs(&submitted, [&base, &gleaned]).await?;
        let policies = [(&base, "experts", "experts alone"), (&gleaned, "gleaned", "experts and gleaned segments")];
        let mut evaluations = Vec::with_capacity(policies.len());
        for (chain, name, trained_on) in policies {
            let policy_id = self.result_of(&submitted, chain, "train")?.id.clone();
            evaluations.push(self.evaluate(name, trained_on, policy_id).await?);
        }
        let threshold = |&beta: &f64| Threshold { beta, selected: select(&episodes, Selection::beta(beta), &ranking) };
        let report = Report {
            plan: self.plan.settings.clone(),
            cell: present(self.plan.cells().last(), "a cell")?.clone(),
            recorded: recordings.counts(experiment.recordings.source()),
            separation: separations(&episodes),
            warnings,
            thresholds: self.plan.betas.iter().map(threshold).collect(),
            histogram,
            experts,
            cohorts: by_cohort(cohort_counts),
            policies: evaluations,
            stages: self.times,
            seconds: began.elapsed().as_secs_f64(),
        };
        Ok(Found { report, episodes })
    }

    // Keeps the duration of a stage for the report and shows it.
    fn done(&mut self, stage: &str, took: Duration, detail: String) {
        self.context.output.note(format_args!("{stage:<18} {:>8}  {detail}", words::duration(took)));
        self.times.push(Stage { stage: stage.to_owned(), seconds: took.as_secs_f64(), detail });
    }

    async fn recordings(&mut self, folder: &Path) -> Result<Recordings> {
        let (context, experiment) = (self.context, &self.plan.experiment);
        let began = Instant::now();
        let all: Vec<_> = experiment.recordings.all().into_iter().map(|of| (of, folder.to_owned())).collect();
        for (collection, folder) in &all {
            recorded(context, folder, collection).await?;
        }
        let took = began.elapsed();
        let recordings = Recordings::ready(context, self.client, &all).await?;
        let steps: u64 = recordings.by_episode.values().map(|recording| recording.steps).sum();
        self.done("record", took, format!("{} episodes, {steps} steps", recordings.by_episode.len()));
        let (bytes, took) = recordings.sent;
        let (megabytes, rate) = (words::megabytes(bytes), words::rate(bytes, took));
        self.done("push", took, format!("{megabytes:.1} MB at {rate:.1} MB/s, each inspected"));
        Ok(recordings)
    }

    // Both policies are trained side by side, each by a worker of its own.
    async fn jobs(&self, folder: &Path, recordings: &Recordings) -> Result<Submitted> {
        let mut state = State::open(folder, self.plan.experiment.sizes)?;
        let submitter = Submitter::new(self.client, &mut state, recordings, &self.plan.experiment, Device::default());
        let mut submitted = submitter.submit(&self.graph).await?;
        to_the_end(self.context, self.client, &self.graph, &mut submitted).await?;
        for chain in self.chains()? {
            if let Standing::Failed(problem) = standing(&self.graph, &submitted, &chain) {
                return Err(Failure::message(problem));
            }
        }
        Ok(submitted)
    }

    /// Of the experts alone, and of experts and gleaned segments.
    fn chains(&self) -> Result<[Chain; 2]> {
        let chains: Vec<Chain> = self.graph.chains.iter().flatten().flatten().cloned().collect();
        present(chains.try_into().ok(), "two chains of stages")
    }

    /// The result of the stage of this kind.
    fn result_of<'s>(&self, submitted: &'s Submitted, chain: &Chain, kind: &str) -> Result<&'s StageResult> {
        let index = present(self.graph.find(chain, kind), "a stage of this kind")?;
        stage_result(submitted, index).map_err(|gap| Failure::message(gap.problem().unwrap_or_default()))
    }

    async fn time_jobs(&mut self, submitted: &Submitted, [base, gleaned]: [&Chain; 2]) -> Result<()> {
        let job = |chain: &Chain, kind: &str| present(self.result_of(submitted, chain, kind)?.job.clone(), "a job");
        let took = |job: &Job| Duration::from_secs_f64(seconds(job).unwrap_or_default().max(0.0));
        let (pretrain, score) = (job(base, "pretrain")?, job(gleaned, "score")?);
        let trainings = [job(base, "train")?, job(gleaned, "train")?];
        let dataset_id = self.result_of(submitted, gleaned, "dataset")?.id.clone();

        let memory = words::megabytes(pretrain.peak_memory_bytes);
        self.done("pretrain", took(&pretrain), format!("{} steps, peak {memory:.0} MB", pretrain.total));
        self.done("score", took(&score), score.message.clone());
        let dataset = self.client.datasets().get_dataset(GetDatasetRequest { dataset_id }).await?.into_inner().dataset;
        let dataset = present(dataset, "a dataset")?;
        let (kept, experts) = (dataset.kept_segments.unwrap_or(0), dataset.expert_segments.unwrap_or(0));
        self.done("dataset", Duration::ZERO, format!("{kept} kept and {experts} expert segments"));
        let [of_base, of_gleaned] = [&trainings[0], &trainings[1]].map(|job| words::duration(took(job)));
        let both = took(&trainings[0]).max(took(&trainings[1]));
        let steps = trainings[1].total;
        self.done("train both", both, format!("{steps} steps each, on experts {of_base}, with gleaned {of_gleaned}"));
        Ok(())
    }

    async fn histogram(&self, run: &str) -> Result<GetHistogramResponse> {
        let request = GetHistogramRequest { score_run_id: run.to_owned(), bins: 20, betas: self.plan.betas.clone() };
        let reply = self.client.scores().get_histogram(request).await?.into_inner();
        self.context.output.note(histogram::histogram(&reply, terminal_width()));
        Ok(reply)
    }

    async fn evaluate(&mut self, name: &str, trained_on: &str, policy_id: String) -> Result<Evaluation> {
        let began = Instant::now();
        let experiment = &self.plan.experiment;
        let deployment = format!("{}@{name}", experiment.recordings.of(0).task);
        let request = DeployRequest { name: deployment.clone(), policy_id, ..DeployRequest::default() };
        self.client.policies().deploy(request).await?;
        let plan = DrivePlan {
            deployment,
            task: self.plan.recordings.task,
            config: self.plan.recordings.config,
            episodes: present(self.plan.cells().next(), "a cell")?.episodes,
            seed: self.plan.drive.seed,
            sessions: self.plan.drive.sessions,
            real_time: None,
            record: None,
        };
        let driven = drive::drive(self.context, self.client, &plan).await?;
        let success_rate = words::success_rate(&driven);
        self.done(&format!("evaluate {name}"), began.elapsed(), success_rate.clone());
        Ok(Evaluation { trained_on: trained_on.to_owned(), result: drive::document(&plan, &driven), success_rate })
    }
}
