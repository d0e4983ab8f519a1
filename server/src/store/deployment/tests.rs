//! Deployments: history and rolling back.

use super::*;
use crate::{
    domain::{
        episode::Outcome,
        id::{PolicyId, ScoreRunId},
        score::Encoder,
        task::Task,
    },
    error::Kind,
    store::testing::{self, results},
};

#[tokio::test]
async fn a_deployment_keeps_its_history() {
    let (_dir, store, task, encoder, first) = with_policy().await;
    let second = results::policy(&store, &task, &encoder, blake3::hash(b"policy").into()).await.id;

    assert_eq!(store.deployment("arm@prod").await.unwrap_err().kind(), Kind::NotFound);
    for policy in [&first, &second, &second, &first] {
        store.deploy("arm@prod", &task.id, &Assignment::of(policy)).await.unwrap();
    }
    store.deploy("arm@test", &task.id, &Assignment::of(&second)).await.unwrap();

    let deployment = store.deployment("arm@prod").await.unwrap();
    let history: Vec<_> = deployment.history.iter().map(|change| change.assignment.policy_id.clone()).collect();
    assert_eq!(history, [first.clone(), second.clone(), first.clone()], "deploying it again is no change");
    assert_eq!(deployment.policy_id(), Some(&first));
    let all = store.deployments(None).await.unwrap();
    assert_eq!(all.iter().map(|one| one.name.as_str()).collect::<Vec<_>>(), ["arm@prod", "arm@test"]);
    assert_eq!(store.deployments(Some(&task.id)).await.unwrap().len(), 2);
    assert!(store.deployments(Some(&TaskId::new())).await.unwrap().is_empty());
    let newest_first: Vec<_> = store.policies(&task.id).await.unwrap().into_iter().map(|one| one.id).collect();
    assert_eq!(newest_first, [second, first]);
}

#[tokio::test]
async fn a_name_stays_with_its_task() {
    let (_dir, store, task, _, policy) = with_policy().await;
    store.deploy("arm@prod", &task.id, &Assignment::of(&policy)).await.unwrap();
    let mut spec = testing::spec();
    spec.name = "other".into();
    let other = store.insert_task(&spec).await.unwrap();

    let error = store.deploy("arm@prod", &other.id, &Assignment::of(&policy)).await.unwrap_err();
    assert_eq!(error.kind(), Kind::Precondition);
    assert_eq!(store.deployment("arm@prod").await.unwrap().history.len(), 1, "no row was written");
}

#[tokio::test]
async fn rolling_back_walks_the_history() {
    let (_dir, store, task, encoder, first) = with_policy().await;
    let mut made = vec![first];
    for _ in 1..4 {
        made.push(results::policy(&store, &task, &encoder, blake3::hash(b"policy").into()).await.id);
    }
    let back = async || store.roll_back("arm").await.map(|deployment| deployment.policy_id().cloned().unwrap());

    assert_eq!(back().await.unwrap_err().kind(), Kind::NotFound);
    assert_eq!(store.before("arm").await.unwrap_err().kind(), Kind::NotFound);
    for policy in &made[..3] {
        store.deploy("arm", &task.id, &Assignment::of(policy)).await.unwrap();
    }
    assert_eq!(store.before("arm").await.unwrap(), Assignment::of(&made[1]));
    assert_eq!(back().await.unwrap(), made[1]);
    assert_eq!(back().await.unwrap(), made[0], "rolling back twice goes two steps back");
    assert_eq!(back().await.unwrap_err().kind(), Kind::Precondition);
    assert_eq!(store.before("arm").await.unwrap_err().kind(), Kind::Precondition);

    store.deploy("arm", &task.id, &Assignment::of(&made[3])).await.unwrap();
    assert_eq!(back().await.unwrap(), made[0], "a new deployment continues from there");
    let history = store.deployment("arm").await.unwrap().history;
    let kept: Vec<_> = history.into_iter().map(|change| change.assignment.policy_id).collect();
    assert_eq!(kept, [0, 1, 2, 1, 0, 3, 0].map(|index: usize| made[index].clone()), "the history is complete");
}

/// A store with a policy that can be deployed, and the encoder that its training started from.
async fn with_policy() -> (tempfile::TempDir, Store, Task, Encoder, PolicyId) {
    let (dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    testing::episode(&store, &task, Outcome::Success, "").await;
    testing::episode(&store, &task, Outcome::Failure, "").await;
    let encoder = results::encoder(&store, &task).await;
    let policy = results::policy(&store, &task, &encoder, blake3::hash(b"policy").into()).await.id;
    (dir, store, task, encoder, policy)
}

#[tokio::test]
async fn a_score_run_is_deployed_and_rolled_back_with_its_policy() {
    let (_dir, store, task, encoder, policy) = with_policy().await;
    let run = results::run(&store, &task, &encoder, &[]).await.id;
    let to = |run: Option<&ScoreRunId>| Assignment { score_run_id: run.cloned(), ..Assignment::of(&policy) };
    let deploy = async |run| store.deploy("arm", &task.id, &to(run)).await.unwrap();

    assert_eq!(deploy(None).await.score_run_id(), None);
    assert_eq!(deploy(Some(&run)).await.score_run_id(), Some(&run), "another run is a change");
    assert_eq!(deploy(Some(&run)).await.history.len(), 2, "an equal assignment is no change");
    assert_eq!(deploy(None).await.score_run_id(), None);
    assert_eq!(store.before("arm").await.unwrap(), to(Some(&run)));
    let back = store.roll_back("arm").await.unwrap();
    assert_eq!((back.policy_id(), back.score_run_id()), (Some(&policy), Some(&run)));
    let kept: Vec<_> = back.history.iter().map(|change| change.assignment.score_run_id.as_ref()).collect();
    assert_eq!(kept, [None, Some(&run), None, Some(&run)]);
    assert_eq!(store.deployments(None).await.unwrap()[0].score_run_id(), Some(&run));
}

#[tokio::test]
async fn hiding_the_history_is_a_change_and_is_rolled_back() {
    let (_dir, store, task, _, policy) = with_policy().await;
    let hidden = |deployment: Deployment| deployment.assignment().unwrap().hide_history;
    let shown = Assignment::of(&policy);
    let hiding = Assignment { hide_history: true, ..shown.clone() };
    assert!(!hidden(store.deploy("arm", &task.id, &shown).await.unwrap()));
    assert!(hidden(store.deploy("arm", &task.id, &hiding).await.unwrap()));
    assert_eq!(store.deploy("arm", &task.id, &hiding).await.unwrap().history.len(), 2);
    assert!(!hidden(store.roll_back("arm").await.unwrap()));
}

#[tokio::test]
async fn a_deleted_deployment_leaves_the_others_and_the_policies() {
    let (_dir, store, task, encoder, first) = with_policy().await;
    let second = results::policy(&store, &task, &encoder, blake3::hash(b"second").into()).await.id;
    for name in ["arm@prod", "arm@test"] {
        for policy in [&first, &second] {
            store.deploy(name, &task.id, &Assignment::of(policy)).await.unwrap();
        }
    }
    store.roll_back("arm@prod").await.unwrap();

    store.delete_deployment("arm@prod").await.unwrap();
    assert_eq!(store.deployment("arm@prod").await.unwrap_err().kind(), Kind::NotFound);
    assert_eq!(store.delete_deployment("arm@prod").await.unwrap_err().kind(), Kind::NotFound);
    assert_eq!(store.deployment("arm@test").await.unwrap().history.len(), 2);
    assert_eq!(store.policies(&task.id).await.unwrap().len(), 2);
    let again = store.deploy("arm@prod", &task.id, &Assignment::of(&second)).await.unwrap();
    assert_eq!((again.policy_id(), again.history.len()), (Some(&second), 1));
}
