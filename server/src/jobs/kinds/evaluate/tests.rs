//! Evaluations that hide the history of a policy.

use gleaner_core::TrainSpec;

use super::*;
use crate::{
    domain::{
        episode::Outcome,
        order::{JobOrder, Queueing},
        policy::{Assignment, Policy},
        task::Task,
    },
    error::Kind,
    jobs::testing::Bench,
    store::testing::{self, results},
};

/// A bench whose task is that of the simulator, and that task.
async fn simulated_task(bench: &Bench) -> Task {
    let spec = gleaner_sim::task_spec(gleaner_sim::Task::PickCube, &gleaner_sim::SimConfig::default());
    let task = bench.store.insert_task(&spec).await.unwrap();
    for outcome in [Outcome::Success, Outcome::Failure] {
        testing::episode(&bench.store, &task, outcome, "").await;
    }
    task
}

async fn trained(bench: &Bench, task: &Task, spec: TrainSpec) -> Policy {
    let encoder = results::encoder(&bench.store, task).await;
    let checkpoint = blake3::hash(spec.policy.name.as_bytes()).into();
    results::policy_of(&bench.store, task, &encoder, spec, checkpoint).await
}

async fn evaluated(bench: &Bench, task: &Task, subject: Subject, hide_history: bool) -> Result<EvaluateSpec> {
    let order = JobOrder::Evaluate { subject, spec: EvaluateSpec { hide_history, ..EvaluateSpec::default() } };
    let job = bench.jobs.submit(&task.id, order, Queueing::default()).await?;
    let JobSpec::Evaluate { spec, .. } = job.spec else { panic!("not evaluate") };
    Ok(spec)
}

#[tokio::test]
async fn a_history_is_hidden_in_trials_of_policies_that_have_one() {
    let bench = Bench::new().await;
    let task = simulated_task(&bench).await;
    let with = trained(&bench, &task, results::finetune()).await;
    let without = trained(&bench, &task, TrainSpec::default()).await;
    let refused = evaluated(&bench, &task, Subject::Policy(without.id.clone()), true).await.unwrap_err();
    assert_eq!(refused.kind(), Kind::Invalid, "{refused}");
    let words = format!(
        "spec.evaluate.settings.hide_history: needs a policy with a history: {} acts on the newest step alone; leave it out",
        without.id
    );
    assert_eq!(refused.message(), words);
    assert!(!evaluated(&bench, &task, Subject::Policy(without.id.clone()), false).await.unwrap().hide_history);
    assert!(evaluated(&bench, &task, Subject::Policy(with.id), true).await.unwrap().hide_history);
}

/// Versions before the check of deployments stored such ones, and their sessions are served.
#[tokio::test]
async fn a_stored_deployment_that_hides_no_history_is_evaluated() {
    let bench = Bench::new().await;
    let task = simulated_task(&bench).await;
    let without = trained(&bench, &task, TrainSpec::default()).await;
    let hiding = Assignment { hide_history: true, ..Assignment::of(&without.id) };
    bench.store.deploy("old", &task.id, &hiding).await.unwrap();
    let old = || Subject::Deployment("old".into());
    assert!(evaluated(&bench, &task, old(), false).await.unwrap().hide_history);
    assert_eq!(evaluated(&bench, &task, old(), true).await.unwrap_err().kind(), Kind::Invalid);
}
