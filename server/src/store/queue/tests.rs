//! Claims, moves, retries and cancels, on a real database.

use super::*;
use crate::{
    domain::{
        id::{DatasetId, ExportId},
        job::JobSpec,
        order::{NewJob, Plan},
        task::Task,
        work::Progress,
    },
    error::Kind,
    store::{attempt::Claimant, testing},
};

fn export(task: &Task, priority: i32, needs: &[&JobId]) -> NewJob {
    NewJob {
        id: JobId::new(),
        task_id: task.id.clone(),
        spec: JobSpec::Export { dataset_id: DatasetId::new(), spec: Default::default() },
        result_id: ExportId::new().into(),
        priority,
        max_attempts: 3,
        engine_options: String::new(),
        needs: needs.iter().map(|&id| id.clone()).collect(),
        keyed: None,
    }
}

async fn queue(store: &Store, job: NewJob) -> Result<JobId> {
    let id = job.id.clone();
    store.insert_plan(&Plan { jobs: vec![job], ..Plan::default() }).await.map(|_| id)
}

/// Claims the next job under a new token.
async fn claim(store: &Store) -> Option<(Attempt, Job)> {
    let token_hash = JobId::new().to_string();
    let job = store.claim_job(&token_hash, "local").await.unwrap()?;
    Some((Attempt { job_id: job.id.clone(), token_hash }, job))
}

async fn succeed(store: &Store, attempt: &Attempt) {
    let mut tx = store.write().await.unwrap();
    let job = attempt::running(&mut tx, attempt).await.unwrap().unwrap();
    advance(&mut tx, &job, JobState::Succeeded, "done", "").await.unwrap();
    store.commit(tx).await.unwrap();
}

/// As after a connection that was lost during the commit of the claim.
#[tokio::test]
async fn claim_that_was_not_noticed_is_given_back_without_an_attempt() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    let id = queue(&store, export(&task, 0, &[])).await.unwrap();
    let (attempt, _) = claim(&store).await.unwrap();
    store.give_back("another claim").await.unwrap();
    assert_eq!(store.job(&id).await.unwrap().state, JobState::Running);
    store.give_back(&attempt.token_hash).await.unwrap();
    let job = store.job(&id).await.unwrap();
    assert_eq!((job.state, job.attempt), (JobState::Queued, 0));
}

#[tokio::test]
async fn the_highest_priority_runs_first_then_the_oldest() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    let mut ids = Vec::new();
    for priority in [0, 5, -1, 5] {
        // Ids of one millisecond may be in any order.
        let mut job = export(&task, priority, &[]);
        job.id = JobId::try_from(format!("job_01ARZ3NDEKTSV4RRFFQ69G5FA{}", ids.len())).unwrap();
        ids.push(queue(&store, job).await.unwrap());
    }
    let mut claimed = Vec::new();
    while let Some((_, job)) = claim(&store).await {
        assert_eq!((job.state, job.attempt), (JobState::Running, 1));
        assert!(job.started_at.is_some());
        claimed.push(job.id);
    }
    assert_eq!(claimed, [1, 3, 0, 2].map(|i: usize| ids[i].clone()));
}

#[tokio::test]
async fn a_job_waits_for_all_it_needs() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    let first = queue(&store, export(&task, 0, &[])).await.unwrap();
    let second = queue(&store, export(&task, 0, &[])).await.unwrap();
    let last = queue(&store, export(&task, 9, &[&first, &second])).await.unwrap();
    let needs = store.job(&last).await.unwrap().needs;
    assert!(needs.len() == 2 && needs.contains(&first) && needs.contains(&second));

    let (one, _) = claim(&store).await.unwrap();
    let (other, _) = claim(&store).await.unwrap();
    succeed(&store, &one).await;
    assert!(claim(&store).await.is_none(), "one need is not enough");
    succeed(&store, &other).await;
    assert_eq!(claim(&store).await.unwrap().1.id, last);
}

#[tokio::test]
async fn each_job_is_claimed_once_by_concurrent_workers() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    let mut ids = Vec::new();
    for _ in 0..12 {
        ids.push(queue(&store, export(&task, 0, &[])).await.unwrap());
    }
    let mut askers = tokio::task::JoinSet::new();
    for _ in 0..24 {
        let store = store.clone();
        askers.spawn(async move { claim(&store).await.map(|(_, job)| job.id) });
    }
    let mut claimed: Vec<JobId> = askers.join_all().await.into_iter().flatten().collect();
    claimed.sort();
    ids.sort();
    assert_eq!(claimed, ids);
}

#[tokio::test]
async fn a_crash_resumes_until_the_attempts_are_used_up() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    let id = queue(&store, export(&task, 0, &[])).await.unwrap();
    let waiting = queue(&store, export(&task, 0, &[&id])).await.unwrap();
    let blob = BlobId::from(blake3::hash(b"checkpoint"));
    let crash = AttemptEnd::Broken("the worker was killed by signal 9".to_owned());
    for attempt in 1..=3 {
        let (held, job) = claim(&store).await.unwrap();
        assert_eq!((job.attempt, job.checkpoint_step), (attempt, (attempt > 1).then_some(400)));
        if attempt == 1 {
            assert_eq!(store.save_checkpoint(&held, 400, &blob).await.unwrap(), None);
        }
        let moved = store.end_attempt(&held, &crash).await.unwrap().unwrap();
        assert!(store.end_attempt(&held, &crash).await.unwrap().is_none(), "an attempt ends once");
        if attempt < 3 {
            assert_eq!((moved.job.state, moved.dropped), (JobState::Queued, None));
            assert!(moved.job.message.ends_with("resumes from step 400"), "{}", moved.job.message);
        } else {
            assert_eq!((moved.job.state, moved.dropped), (JobState::Failed, Some(blob.clone())));
            assert!(moved.job.error.contains("attempt 3 of 3"), "{}", moved.job.error);
        }
    }
    let dependent = store.job(&waiting).await.unwrap();
    assert_eq!(dependent.state, JobState::Failed);
    assert!(dependent.error.contains(id.as_str()), "{}", dependent.error);
}

#[tokio::test]
async fn a_requeued_job_drops_the_metrics_and_the_progress_after_its_checkpoint() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    let id = queue(&store, export(&task, 0, &[])).await.unwrap();
    let (held, _) = claim(&store).await.unwrap();
    let blob = BlobId::from(blake3::hash(b"checkpoint"));
    let metrics = (1..=5).map(|step| (step, "loss".to_owned(), 0.5)).collect();
    let progress = Progress { done: 5, total: 9, metrics, peak_memory_bytes: 7, ..Progress::default() };
    assert!(!store.report_progress(&held, &progress).await.unwrap());
    store.save_checkpoint(&held, 3, &blob).await.unwrap();
    let seen = store.metrics(&id, 0, 100).await.unwrap();
    store.end_attempt(&held, &AttemptEnd::Stopped).await.unwrap();

    let left = store.metrics(&id, 0, 100).await.unwrap();
    assert_eq!(left.iter().map(|metric| metric.step).collect::<Vec<_>>(), [1, 2, 3]);
    let (held, job) = claim(&store).await.unwrap();
    assert_eq!((job.attempt, job.done, job.peak_memory_bytes), (1, 3, 7), "a stop costs no attempt");
    let again = Progress { metrics: vec![(4, "loss".to_owned(), 0.25)], ..progress };
    store.report_progress(&held, &again).await.unwrap();
    let watched = store.metrics(&id, seen.last().unwrap().sequence, 100).await.unwrap();
    assert_eq!(watched.len(), 1, "an earlier watcher receives later metrics");
}

#[tokio::test]
async fn a_requeued_job_without_a_checkpoint_begins_at_zero_and_an_ended_one_keeps_its_progress() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    let id = queue(&store, export(&task, 0, &[])).await.unwrap();
    let progress = Progress { done: 5, total: 9, ..Progress::default() };
    let wrong = AttemptEnd::Permanent("no such file".to_owned());
    for (end, done) in [(AttemptEnd::Interrupted("node1 failed".to_owned()), 0), (wrong, 5)] {
        let (held, _) = claim(&store).await.unwrap();
        store.report_progress(&held, &progress).await.unwrap();
        store.end_attempt(&held, &end).await.unwrap();
        let job = store.job(&id).await.unwrap();
        assert_eq!((job.done, job.total), (done, 9), "{end:?}");
    }
}

/// Digesting a checkpoint takes seconds, within which an attempt may save the next one.
#[tokio::test]
async fn a_checkpoint_that_replaced_an_unusable_one_is_kept() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    let id = queue(&store, export(&task, 0, &[])).await.unwrap();
    let (held, _) = claim(&store).await.unwrap();
    let [first, second] = [b"first".as_slice(), b"second"].map(|content| BlobId::from(blake3::hash(content)));
    let metrics = vec![(20, "loss".to_owned(), 0.5)];
    store.report_progress(&held, &Progress { done: 20, metrics, ..Progress::default() }).await.unwrap();
    store.save_checkpoint(&held, 20, &second).await.unwrap();
    let standing = async || {
        let job = store.job(&id).await.unwrap();
        (job.checkpoint, job.done, store.metrics(&id, 0, 9).await.unwrap().len())
    };
    store.drop_checkpoint(&id, &first).await.unwrap();
    assert_eq!(standing().await, (Some(second.clone()), 20, 1));
    store.drop_checkpoint(&id, &second).await.unwrap();
    assert_eq!(standing().await, (None, 0, 0));
}

#[tokio::test]
async fn a_cancel_includes_queued_dependents_and_stops_the_worker() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    let first = queue(&store, export(&task, 0, &[])).await.unwrap();
    let second = queue(&store, export(&task, 0, &[&first])).await.unwrap();
    let third = queue(&store, export(&task, 0, &[&second])).await.unwrap();
    let other = queue(&store, export(&task, -5, &[])).await.unwrap();
    let (held, _) = claim(&store).await.unwrap();

    let cancelled = store.cancel_job(&first).await.unwrap().job;
    assert_eq!((cancelled.state, cancelled.cancel_requested), (JobState::Running, true));
    for dependent in [&second, &third] {
        assert_eq!(store.job(dependent).await.unwrap().state, JobState::Cancelled);
    }
    assert_eq!(store.job(&other).await.unwrap().state, JobState::Queued);
    assert!(store.report_progress(&held, &Progress::default()).await.unwrap(), "the worker is asked to stop");
    let crash = AttemptEnd::Broken("the worker ended with code 1".to_owned());
    let ended = store.end_attempt(&held, &crash).await.unwrap().unwrap().job;
    assert_eq!(ended.state, JobState::Cancelled);
    assert!(ended.ended_at.is_some());
    assert_eq!(store.cancel_job(&first).await.unwrap_err().kind(), Kind::Precondition);
    assert_eq!(store.cancel_job(&JobId::new()).await.unwrap_err().kind(), Kind::NotFound);
}

#[tokio::test]
async fn a_failed_job_cannot_be_waited_for() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    let first = queue(&store, export(&task, 0, &[])).await.unwrap();
    store.cancel_job(&first).await.unwrap();
    let error = queue(&store, export(&task, 0, &[&first])).await.unwrap_err();
    assert_eq!(error.kind(), Kind::Precondition);
    assert!(error.message().contains("cancelled"), "{error}");
    assert_eq!(queue(&store, export(&task, 0, &[&JobId::new()])).await.unwrap_err().kind(), Kind::NotFound);
    let (listed, _) = store.jobs(&crate::domain::order::JobFilter::default(), None, 10).await.unwrap();
    assert_eq!(listed.len(), 1, "a rejected plan leaves no job");
}

#[tokio::test]
async fn reports_of_an_old_attempt_are_refused() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    let id = queue(&store, export(&task, 0, &[])).await.unwrap();
    let (old, _) = claim(&store).await.unwrap();
    assert!(matches!(store.claimant(&old, "one", "").await.unwrap(), Claimant::Worker(job) if job.id == id));
    store.end_attempt(&old, &AttemptEnd::Stopped).await.unwrap();
    let (new, _) = claim(&store).await.unwrap();
    let blob = BlobId::from(blake3::hash(b"checkpoint"));
    assert_eq!(store.claimant(&old, "one", "").await.unwrap(), Claimant::Over);
    assert_eq!(store.report_progress(&old, &Progress::default()).await.unwrap_err().kind(), Kind::Precondition);
    assert_eq!(store.save_checkpoint(&old, 1, &blob).await.unwrap_err().kind(), Kind::Precondition);
    assert!(store.end_attempt(&old, &AttemptEnd::Stopped).await.unwrap().is_none());
    let running = store.running_attempts().await.unwrap();
    assert_eq!(running.into_iter().map(|running| running.attempt).collect::<Vec<_>>(), [new]);
}

#[tokio::test]
async fn only_legal_transitions_are_made() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    let id = queue(&store, export(&task, 0, &[])).await.unwrap();
    let mut tx = store.write().await.unwrap();
    let job = by_id(&mut tx, &id).await.unwrap().unwrap();
    let error = advance(&mut tx, &job, JobState::Succeeded, "done", "").await.unwrap_err();
    assert_eq!(error.kind(), Kind::Precondition);
}

#[tokio::test]
async fn pages_go_backwards_in_time_and_meet() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    for _ in 0..5 {
        queue(&store, export(&task, 0, &[])).await.unwrap();
    }
    let filter =
        crate::domain::order::JobFilter { task_id: Some(task.id.clone()), state: Some(JobState::Queued), kind: None };
    let (all, end) = store.jobs(&filter, None, 5).await.unwrap();
    assert!(all.is_sorted_by(|a, b| a.id > b.id) && end.is_none());
    let (first, next) = store.jobs(&filter, None, 3).await.unwrap();
    let (second, end) = store.jobs(&filter, next.as_ref(), 3).await.unwrap();
    assert_eq!(([first, second].concat(), end), (all, None));
    let none = crate::domain::order::JobFilter { state: Some(JobState::Failed), ..filter };
    assert!(store.jobs(&none, None, 3).await.unwrap().0.is_empty());
}
