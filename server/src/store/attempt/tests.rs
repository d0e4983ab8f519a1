//! The binding of attempts to processes, and their places, on a real database.

use super::*;
use crate::{
    domain::{attempt::AttemptEnd, id::JobId},
    store::testing,
};

async fn claimed(store: &Store) -> Attempt {
    testing::claimed(store, &testing::task(store).await.id, "slurm").await
}

async fn again(store: &Store) -> Attempt {
    let token_hash = JobId::new().to_string();
    let job = store.claim_job(&token_hash, "slurm").await.unwrap().unwrap();
    Attempt { job_id: job.id, token_hash }
}

#[tokio::test]
async fn the_first_process_that_calls_is_the_only_one() {
    let (_dir, store) = testing::store().await;
    let attempt = claimed(&store).await;
    assert!(!store.running_attempts().await.unwrap()[0].bound);
    assert!(
        matches!(store.claimant(&attempt, "one", "").await.unwrap(), Claimant::Worker(job) if job.id == attempt.job_id)
    );
    assert_eq!(store.claimant(&attempt, "two", "").await.unwrap(), Claimant::Other);
    assert!(matches!(store.claimant(&attempt, "one", "").await.unwrap(), Claimant::Worker(_)));
    assert!(store.running_attempts().await.unwrap()[0].bound);

    store.end_attempt(&attempt, &AttemptEnd::Stopped).await.unwrap();
    assert_eq!(store.claimant(&attempt, "one", "").await.unwrap(), Claimant::Over);
    let next = again(&store).await;
    assert!(matches!(store.claimant(&next, "two", "").await.unwrap(), Claimant::Worker(_)), "the next attempt is free");
    assert_eq!(store.claimant(&attempt, "two", "").await.unwrap(), Claimant::Over, "of the earlier attempt");
}

#[tokio::test]
async fn one_of_many_concurrent_processes_is_bound() {
    let (_dir, store) = testing::store().await;
    let attempt = claimed(&store).await;
    let mut calls = tokio::task::JoinSet::new();
    for process in 0..16 {
        let (store, attempt) = (store.clone(), attempt.clone());
        calls.spawn(async move { store.claimant(&attempt, &process.to_string(), "").await.unwrap() });
    }
    let bound = calls.join_all().await.into_iter().filter(|claimant| matches!(claimant, Claimant::Worker(_))).count();
    assert_eq!(bound, 1);
}

#[tokio::test]
async fn the_place_of_an_attempt_stays_with_its_job_until_the_next_attempt() {
    let (_dir, store) = testing::store().await;
    let attempt = claimed(&store).await;
    let place = Placement {
        engine: "slurm".to_owned(),
        engine_id: "17".to_owned(),
        node: String::new(),
        waiting: "Resources".to_owned(),
    };
    store.place_attempt(&attempt, &place).await.unwrap();
    assert_eq!(store.running_attempts().await.unwrap()[0].placement, place);
    store.claimant(&attempt, "one", "node1").await.unwrap();
    let begun = store.job(&attempt.job_id).await.unwrap().placement;
    assert_eq!((begun.node.as_str(), begun.waiting.as_str()), ("node1", ""), "a worker that calls has begun");
    store.place_attempt(&attempt, &place).await.unwrap();
    store.end_attempt(&attempt, &AttemptEnd::Stopped).await.unwrap();
    let ended = store.job(&attempt.job_id).await.unwrap().placement;
    assert_eq!((ended.engine_id.as_str(), ended.node.as_str(), ended.waiting.as_str()), ("17", "node1", ""));
    let next = again(&store).await;
    store.place_attempt(&attempt, &ended).await.unwrap();
    let placement = store.job(&next.job_id).await.unwrap().placement;
    assert_eq!(
        placement,
        Placement { engine: "slurm".to_owned(), ..Placement::default() },
        "an old attempt has no place"
    );
}
