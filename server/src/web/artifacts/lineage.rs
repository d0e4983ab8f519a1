//! The lineage of a result: every input back to the episodes, and the results one step ahead.

use std::collections::{BTreeSet, VecDeque};

use maud::Markup;

use super::{
    card::{self, Card, Stage},
    link, rate,
};
use crate::{
    domain::{
        curation::Input,
        dataset::Dataset,
        id::PolicyId,
        job::{Job, JobKind, JobSpec, JobState},
        policy::Deployment,
        snapshot::Snapshot,
    },
    error::Result,
    store::Store,
    web::text,
};

/// The lineage of a job's result.
///
/// # Errors
/// Internal.
pub(in crate::web) async fn of_job(store: &Store, job: &Job) -> Result<Markup> {
    let mut family = Family::new(store);
    family.add(of_result(job));
    family.before(job.clone()).await?;
    let lineage = store.lineage(job).await?;
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

/// The lineage of a dataset.
///
/// # Errors
/// Internal.
pub(in crate::web) async fn of_dataset(store: &Store, dataset: &Dataset) -> Result<Markup> {
    let mut family = Family::new(store);
    family.add(of_a_dataset(dataset));
    if let Some(scoring) = store.job_of_result(dataset.score_run_id.as_str()).await? {
        family.add(of_result(&scoring));
        family.before(scoring).await?;
    }
    family.after(&store.jobs_naming(&dataset.task_id, &[dataset.id.as_str()]).await?);
    Ok(card::row(&family.cards, dataset.id.as_str()))
}

/// A snapshot, the results of its jobs, and the selections of its runs.
///
/// # Errors
/// Internal.
pub(in crate::web) async fn of_snapshot(store: &Store, snapshot: &Snapshot) -> Result<Markup> {
    let mut family = Family::new(store);
    family.add(of_episodes(snapshot));
    let jobs = store.jobs_naming(&snapshot.task_id, &[snapshot.id.as_str()]).await?;
    let results: BTreeSet<&str> = jobs.iter().map(|job| job.result_id.as_str()).collect();
    let datasets = store.datasets(&snapshot.task_id).await?;
    let selected = datasets.iter().filter(|dataset| results.contains(dataset.score_run_id.as_str()));
    selected.for_each(|dataset| family.add(of_a_dataset(dataset)));
    family.after(&jobs);
    Ok(card::row(&family.cards, snapshot.id.as_str()))
}

struct Family<'a> {
    store: &'a Store,
    known: BTreeSet<String>,
    cards: Vec<Card>,
}

impl<'a> Family<'a> {
    fn new(store: &'a Store) -> Self {
        Self { store, known: BTreeSet::new(), cards: Vec::new() }
    }

    fn add(&mut self, card: Card) {
        if self.known.insert(card.id.clone()) {
            self.cards.push(card);
        }
    }

    /// Every input named by a job's spec, and their own inputs.
    async fn before(&mut self, job: Job) -> Result<()> {
        let mut makers = VecDeque::from([job]);
        while let Some(job) = makers.pop_front() {
            for (input, maker) in self.store.inputs(&job).await? {
                match &input {
                    Input::Snapshot(id) if !self.known.contains(id.as_str()) => {
                        let snapshot = self.store.frozen(id).await?;
                        self.add(of_episodes(&snapshot));
                    }
                    Input::Dataset(dataset) => self.add(of_a_dataset(dataset)),
                    Input::Snapshot(_) | Input::Encoder(_) | Input::ScoreRun(_) | Input::Policy(_) => {}
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
        for evaluation in self.store.evaluations(policy).await? {
            self.add(Card {
                stage: Stage::Use,
                to: evaluation.job_id.as_ref().map(|job| format!("/jobs/{job}")),
                says: format!("{} in {}", rate(&evaluation.success()), evaluation.simulation),
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
    let (stage, to, says) = match &job.spec {
        JobSpec::Pretrain { spec, .. } => (Stage::Encoder, own, text::counted(spec.optim.steps, "step")),
        JobSpec::Score { spec, .. } => (Stage::Scores, own, spec.scorer.name.clone()),
        JobSpec::Train { spec, .. } => {
            let says = format!("{}, {}", spec.policy.name, text::counted(spec.optim.steps, "step"));
            (Stage::Policy, own, says)
        }
        JobSpec::Export { .. } => (Stage::Use, made_by, "export".to_owned()),
        JobSpec::Evaluate { spec, .. } => (Stage::Use, made_by, format!("evaluation in {}", spec.simulation)),
    };
    let state = (job.state != JobState::Succeeded).then_some(job.state);
    Card { stage, id: job.result_id.clone(), to, says, state }
}

fn of_a_dataset(dataset: &Dataset) -> Card {
    Card {
        stage: Stage::Dataset,
        id: dataset.id.to_string(),
        to: Some(format!("/datasets/{}", dataset.id)),
        says: link::selection(dataset.selection),
        state: None,
    }
}

fn of_episodes(snapshot: &Snapshot) -> Card {
    Card {
        stage: Stage::Episodes,
        id: snapshot.id.to_string(),
        to: link::page(snapshot.id.as_str()),
        says: counts(snapshot),
        state: None,
    }
}

fn counts(snapshot: &Snapshot) -> String {
    let Snapshot { expert_episodes, imperfect_episodes, .. } = snapshot;
    format!("{}, {} imperfect", text::counted(*expert_episodes, "expert"), text::count(*imperfect_episodes))
}

/// The counts of a snapshot's episodes, and its rule.
pub(in crate::web) fn episodes(snapshot: &Snapshot) -> String {
    let rule = &snapshot.rule;
    let roles = if rule.by_cohort() {
        let named = |cohorts: &[String]| if cohorts.is_empty() { "none".to_owned() } else { cohorts.join(", ") };
        format!("experts are of {}; imperfect of {}", named(&rule.expert_cohorts), named(&rule.imperfect_cohorts))
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
        says: "deployment".to_owned(),
        state: None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        domain::{episode::Outcome, selection::Selection, snapshot::Role},
        store::testing::{self, results},
    };

    #[tokio::test]
    async fn a_dataset_shows_its_inputs_and_later_results() {
        let (_dir, store) = testing::store().await;
        let task = testing::task(&store).await;
        testing::episode(&store, &task, Outcome::Success, "").await;
        let failure = testing::episode(&store, &task, Outcome::Failure, "").await;
        let encoder = results::encoder(&store, &task).await;
        let scores = results::scores(&failure.id, Role::Imperfect, &[0.5; 20]);
        let run = results::run(&store, &task, &encoder, &[scores]).await;
        let dataset = store.insert_dataset(&run.id, Selection::Beta(0.25)).await.unwrap();
        let spec = JobSpec::Export { dataset_id: dataset.id.clone() };
        let export = crate::domain::id::ExportId::new();
        results::job(&store, &task, spec, export.as_str()).await;

        let shown = of_dataset(&store, &dataset).await.unwrap().into_string();
        for there in [encoder.snapshot_id.as_str(), encoder.id.as_str(), run.id.as_str(), export.as_str()] {
            assert!(shown.contains(there), "{there} is not in {shown}");
        }
        assert!(shown.contains("1 expert, 1 imperfect") && shown.contains("q &gt; 0.25"), "{shown}");
        let scoring = store.job(&run.job_id).await.unwrap();
        let shown = of_job(&store, &scoring).await.unwrap().into_string();
        assert!(shown.contains(&format!("/datasets/{}", dataset.id)) && shown.contains(export.as_str()), "{shown}");
    }
}
