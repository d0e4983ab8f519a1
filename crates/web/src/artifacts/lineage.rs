//! The lineage of a result: every input back to the episodes, and the results one step ahead.

use std::collections::{BTreeSet, VecDeque};

use gleaner_core::{
    Result,
    curation::Input,
    dataset::Dataset,
    id::PolicyId,
    job::{Job, JobKind, JobSpec, JobState},
    policy::{Deployment, Policy},
    remote::RemotePolicy,
    score::ScoreRun,
    snapshot::Snapshot,
};
use maud::Markup;

use super::{
    card::{self, Card, Stage},
    rate,
};
use crate::{Backend, link, text};

/// The lineage of a job's result.
///
/// # Errors
/// Internal.
pub(crate) async fn of_job(backend: &dyn Backend, job: &Job) -> Result<Markup> {
    let mut family = Family::new(backend);
    family.add(of_result(job));
    family.before(job.clone()).await?;
    let lineage = backend.lineage(job).await?;
    for dataset in &lineage.datasets {
        family.add(of_a_dataset(dataset));
    }
    family.after(&lineage.jobs);
    if job.spec.kind() == JobKind::Train {
        family.trials(&PolicyId::parse("result_id", &job.result_id)?).await?;
    }
    lineage.deployments.iter().for_each(|deployment| family.add(of_deployment(deployment)));
    Ok(card::row(&family.cards, &job.result_id))
}

/// The lineage of a score run.
///
/// # Errors
/// Internal.
pub(crate) async fn of_run(backend: &dyn Backend, run: &ScoreRun) -> Result<Markup> {
    if let Some(job) = run.origin.job_id() {
        return of_job(backend, &backend.job(job).await?).await;
    }
    let mut family = Family::new(backend);
    family.imported(run).await?;
    let datasets = backend.datasets(&run.task_id).await?;
    let datasets: Vec<&Dataset> = datasets.iter().filter(|dataset| dataset.score_run_id == run.id).collect();
    datasets.iter().for_each(|dataset| family.add(of_a_dataset(dataset)));
    let named: Vec<&str> = datasets.iter().map(|dataset| dataset.id.as_str()).collect();
    family.after(&backend.jobs_naming(&run.task_id, &named).await?);
    Ok(card::row(&family.cards, run.id.as_str()))
}

/// The lineage of a policy that another server runs: its evaluations and deployments.
///
/// # Errors
/// Internal.
pub(crate) async fn of_remote_policy(
    backend: &dyn Backend,
    (policy, remote): (&Policy, &RemotePolicy),
    deployments: &[Deployment],
) -> Result<Markup> {
    let mut family = Family::new(backend);
    family.add(Card {
        stage: Stage::Policy,
        id: policy.id.to_string(),
        to: link::page(policy.id.as_str()),
        summary: format!("runs on {}", remote.address),
        state: None,
    });
    family.trials(&policy.id).await?;
    deployments.iter().for_each(|deployment| family.add(of_deployment(deployment)));
    Ok(card::row(&family.cards, policy.id.as_str()))
}

/// The lineage of a dataset.
///
/// # Errors
/// Internal.
pub(crate) async fn of_dataset(backend: &dyn Backend, dataset: &Dataset) -> Result<Markup> {
    let mut family = Family::new(backend);
    family.add(of_a_dataset(dataset));
    if let Some(scoring) = backend.job_of_result(dataset.score_run_id.as_str()).await? {
        family.add(of_result(&scoring));
        family.before(scoring).await?;
    } else {
        family.imported(&backend.score_run(&dataset.score_run_id).await?).await?;
    }
    family.after(&backend.jobs_naming(&dataset.task_id, &[dataset.id.as_str()]).await?);
    Ok(card::row(&family.cards, dataset.id.as_str()))
}

/// A snapshot, the results of its jobs, and the selections of its runs.
///
/// # Errors
/// Internal.
pub(crate) async fn of_snapshot(backend: &dyn Backend, snapshot: &Snapshot) -> Result<Markup> {
    let mut family = Family::new(backend);
    family.add(of_episodes(snapshot));
    let jobs = backend.jobs_naming(&snapshot.task_id, &[snapshot.id.as_str()]).await?;
    let mut runs = backend.score_runs(&snapshot.task_id).await?;
    runs.retain(|run| run.origin.job_id().is_none() && run.snapshot_id == snapshot.id);
    runs.iter().for_each(|run| family.add(of_an_import(run)));
    let imported = runs.iter().map(|run| run.id.as_str());
    let results: BTreeSet<&str> = jobs.iter().map(|job| job.result_id.as_str()).chain(imported).collect();
    let datasets = backend.datasets(&snapshot.task_id).await?;
    let selected = datasets.iter().filter(|dataset| results.contains(dataset.score_run_id.as_str()));
    selected.for_each(|dataset| family.add(of_a_dataset(dataset)));
    family.after(&jobs);
    Ok(card::row(&family.cards, snapshot.id.as_str()))
}

struct Family<'a> {
    backend: &'a dyn Backend,
    known: BTreeSet<String>,
    cards: Vec<Card>,
}

impl<'a> Family<'a> {
    fn new(backend: &'a dyn Backend) -> Self {
        Self { backend, known: BTreeSet::new(), cards: Vec::new() }
    }

    fn add(&mut self, card: Card) {
        if self.known.insert(card.id.clone()) {
            self.cards.push(card);
        }
    }

    /// An imported run, its episodes, and its encoder with its own inputs.
    async fn imported(&mut self, run: &ScoreRun) -> Result<()> {
        self.add(of_an_import(run));
        self.add(of_episodes(&self.backend.snapshot(&run.snapshot_id).await?));
        let Some(encoder) = run.origin.encoder_id() else { return Ok(()) };
        if let Some(pretraining) = self.backend.job_of_result(encoder.as_str()).await? {
            self.add(of_result(&pretraining));
            self.before(pretraining).await?;
        }
        Ok(())
    }

    /// Every input named by a job's spec, and their own inputs.
    async fn before(&mut self, job: Job) -> Result<()> {
        let mut makers = VecDeque::from([job]);
        while let Some(job) = makers.pop_front() {
            for (input, maker) in self.backend.inputs(&job).await? {
                match &input {
                    Input::Snapshot(id) if !self.known.contains(id.as_str()) => {
                        let snapshot = self.backend.snapshot(id).await?;
                        self.add(of_episodes(&snapshot));
                    }
                    Input::Dataset(dataset) => self.add(of_a_dataset(dataset)),
                    Input::Snapshot(_) | Input::Encoder(_) | Input::ScoreRun(_) | Input::Policy(_) => {}
                }
                if let (Input::Dataset(dataset), None) = (&input, &maker) {
                    self.add(of_an_import(&self.backend.score_run(&dataset.score_run_id).await?));
                }
                if let Some(maker) = maker.filter(|maker| !self.known.contains(&maker.result_id)) {
                    self.add(of_result(&maker));
                    makers.push_back(maker);
                }
            }
        }
        Ok(())
    }

    /// The results of later jobs, the newest first. Finished evaluations are shown with their rates instead.
    fn after(&mut self, jobs: &[Job]) {
        let tried = |job: &&Job| job.spec.kind() == JobKind::Evaluate && job.state == JobState::Succeeded;
        jobs.iter().rev().filter(|job| !tried(job)).for_each(|job| self.add(of_result(job)));
    }

    async fn trials(&mut self, policy: &PolicyId) -> Result<()> {
        for evaluation in self.backend.evaluations(policy).await? {
            self.add(Card {
                stage: Stage::Use,
                to: evaluation.job_id.as_ref().map(|job| format!("/jobs/{job}")),
                summary: format!("{} in {}", rate(&evaluation.success()), evaluation.simulation),
                id: evaluation.id.into(),
                state: None,
            });
        }
        Ok(())
    }
}

/// The card of a job's result.
fn of_result(job: &Job) -> Card {
    let made_by = Some(format!("/jobs/{}", job.id));
    let own = link::page(&job.result_id).filter(|_| job.state == JobState::Succeeded).or_else(|| made_by.clone());
    let (stage, to, summary) = match &job.spec {
        JobSpec::Pretrain { spec, .. } => (Stage::Encoder, own, text::counted(spec.optim.steps, "step")),
        JobSpec::Score { spec, .. } => (Stage::Scores, own, spec.scorer.name.clone()),
        JobSpec::Train { spec, .. } => {
            let summary = format!("{}, {}", spec.policy.name, text::counted(spec.optim.steps, "step"));
            (Stage::Policy, own, summary)
        }
        JobSpec::Export { .. } => (Stage::Use, made_by, "export".to_owned()),
        JobSpec::Evaluate { spec, .. } => (Stage::Use, made_by, format!("evaluation in {}", spec.simulation)),
    };
    let state = (job.state != JobState::Succeeded).then_some(job.state);
    Card { stage, id: job.result_id.clone(), to, summary, state }
}

fn of_an_import(run: &ScoreRun) -> Card {
    let id = run.id.to_string();
    Card { stage: Stage::Scores, to: link::page(&id), id, summary: run.origin.scorer().to_owned(), state: None }
}

fn of_a_dataset(dataset: &Dataset) -> Card {
    Card {
        stage: Stage::Dataset,
        id: dataset.id.to_string(),
        to: Some(format!("/datasets/{}", dataset.id)),
        summary: link::selection(dataset.selection),
        state: None,
    }
}

fn of_episodes(snapshot: &Snapshot) -> Card {
    Card {
        stage: Stage::Episodes,
        id: snapshot.id.to_string(),
        to: link::page(snapshot.id.as_str()),
        summary: counts(snapshot),
        state: None,
    }
}

fn counts(snapshot: &Snapshot) -> String {
    let Snapshot { expert_episodes, imperfect_episodes, .. } = snapshot;
    format!("{}, {} imperfect", text::counted(*expert_episodes, "expert"), text::count(*imperfect_episodes))
}

/// The counts of a snapshot's episodes, and its rule.
pub(crate) fn episodes(snapshot: &Snapshot) -> String {
    let rule = &snapshot.rule;
    let roles = if rule.by_cohort() {
        let named =
            |cohorts: &[String], all: &str| if cohorts.is_empty() { all.to_owned() } else { cohorts.join(", ") };
        let (experts, imperfect) =
            (named(&rule.expert_cohorts, "every success"), named(&rule.imperfect_cohorts, "every failure"));
        format!("experts are of {experts}; imperfect of {imperfect}")
    } else {
        "experts were labelled success, imperfect failure".to_owned()
    };
    let experts = if rule.max_experts > 0 { format!("; at most {} experts", rule.max_experts) } else { String::new() };
    let imperfect = if rule.imperfect_per_expert > 0.0 {
        format!("; at most {} imperfect for each expert", rule.imperfect_per_expert)
    } else {
        String::new()
    };
    format!("{}; {roles}{experts}{imperfect}", counts(snapshot))
}

fn of_deployment(deployment: &Deployment) -> Card {
    Card {
        stage: Stage::Use,
        id: deployment.name.clone(),
        to: Some(format!("/deployments/{}", deployment.name)),
        summary: "deployment".to_owned(),
        state: None,
    }
}
