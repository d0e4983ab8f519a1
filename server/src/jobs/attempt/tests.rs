//! The output of a worker until its end, and machines that cannot start one.

use std::{
    sync::atomic::{AtomicU32, Ordering},
    time::SystemTime,
};

use gleaner_core::PretrainSpec;
use tokio::io::AsyncWriteExt as _;

use super::*;
use crate::{
    domain::{
        id::JobId,
        job::JobState,
        order::{JobOrder, Queueing},
        snapshot::RoleRule,
    },
    jobs::{
        engine::{Engine, Launch, Output},
        log,
        testing::Bench,
    },
};

/// The engine of a machine that starts no process for some attempts.
struct Exhausted(AtomicU32);

impl Engine for Exhausted {
    fn name(&self) -> &'static str {
        "local"
    }

    fn outlives_server(&self) -> bool {
        false
    }

    fn takes_options(&self) -> bool {
        false
    }

    fn start(&self, _: Launch<'_>) -> Result<Box<dyn Execution>, String> {
        match self.0.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |left| left.checked_sub(1)) {
            Ok(_) => Err("no process is free".to_owned()),
            Err(_) => Ok(Box::new(Ended(End::Broken, "it ended"))),
        }
    }

    fn resume(&self, _: &Attempt, _: &Placement, _: &Arc<Lease>) -> Option<Box<dyn Execution>> {
        None
    }
}

/// A worker that has ended, in this way and with these words.
struct Ended(fn(String) -> End, &'static str);

#[async_trait::async_trait]
impl Execution for Ended {
    fn placement(&self) -> watch::Receiver<Placement> {
        watch::Sender::default().subscribe()
    }

    fn output(&mut self) -> Option<Output> {
        None
    }

    async fn ended(&mut self) -> End {
        self.0(self.1.to_owned())
    }

    async fn kill(&mut self, reason: String) -> End {
        self.0(reason)
    }
}

/// The job after a time limit has ended an attempt that a restarted server resumed: with a checkpoint of this attempt, or of
/// the one before.
async fn after_a_restart(of_this_attempt: bool) -> Job {
    let bench = Bench::new().await;
    bench.jobs.stop().await;
    let order = JobOrder::Pretrain { snapshot_id: None, rule: RoleRule::default(), spec: PretrainSpec::default() };
    let queueing = Queueing { max_attempts: Some(1), ..Queueing::default() };
    bench.jobs.submit(&bench.task.id, order, queueing).await.unwrap();
    let (mut attempt, _) = bench.claim().await;
    let blob = bench.blobs().put(b"weights").unwrap();
    // Of a file that was just written, a file system may have the time of its last tick.
    let stored = if of_this_attempt { SystemTime::now() } else { SystemTime::UNIX_EPOCH };
    std::fs::File::open(bench.blobs().path(&blob)).unwrap().set_modified(stored).unwrap();
    bench.store.save_checkpoint(&attempt, 40, &blob).await.unwrap();
    if !of_this_attempt {
        bench.store.end_attempt(&attempt, &AttemptEnd::Stopped).await.unwrap();
        (attempt, _) = bench.claim().await;
    }
    let jobs = bench.with_engine(Box::new(Exhausted(AtomicU32::new(0))));
    let (job, lease) = (bench.store.job(&attempt.job_id).await.unwrap(), jobs.0.leases.grant(&attempt, Tie::Resumed));
    resume(&jobs.0, job, attempt.clone(), &lease, Box::new(Ended(End::Stopped, "it reached its time limit"))).await;
    bench.store.job(&attempt.job_id).await.unwrap()
}

#[tokio::test]
async fn a_checkpoint_from_before_a_restart_counts_for_its_own_attempt() {
    let progressed = after_a_restart(true).await;
    assert_eq!((progressed.state, progressed.attempt), (JobState::Queued, 0), "{}", progressed.error);
    let stuck = after_a_restart(false).await;
    assert_eq!((stuck.state, stuck.attempt), (JobState::Failed, 1), "{}", stuck.message);
    assert!(stuck.error.contains("before it saved a checkpoint"), "{}", stuck.error);
}

/// The job after an attempt on a machine that refuses this many starts.
async fn after(refusals: u32) -> Job {
    let bench = Bench::new().await;
    bench.jobs.stop().await;
    let order = JobOrder::Pretrain { snapshot_id: None, rule: RoleRule::default(), spec: PretrainSpec::default() };
    let queueing = Queueing { max_attempts: Some(1), ..Queueing::default() };
    bench.jobs.submit(&bench.task.id, order, queueing).await.unwrap();
    let issuer = Issuer::new();
    let job = bench.store.claim_job(&issuer.hash, "local").await.unwrap().unwrap();
    let id = job.id.clone();
    let jobs = bench.with_engine(Box::new(Exhausted(AtomicU32::new(refusals))));
    run(&jobs.0, job, issuer).await;
    bench.store.job(&id).await.unwrap()
}

#[tokio::test]
async fn a_machine_that_cannot_start_a_worker_uses_up_no_attempt() {
    let started = after(3).await;
    assert_eq!((started.state, started.attempt), (JobState::Failed, 1), "{}", started.error);
    assert!(started.error.starts_with("it ended"), "{}", started.error);
    let waiting = after(u32::MAX).await;
    assert_eq!((waiting.state, waiting.attempt), (JobState::Queued, 0), "{}", waiting.error);
    assert!(waiting.message.contains("no process is free; check that gleaner-worker is"), "{}", waiting.message);
}

/// The log of a worker that writes these last words and ends; `lets_go`: its end of the pipe closes too.
async fn log_of(last_output: &[u8], lets_go: bool) -> String {
    let (dir, job) = (tempfile::tempdir().unwrap(), JobId::new());
    let mut log = Log::of(dir.path(), &job).await;
    let (mut worker, output) = tokio::io::duplex(4096);
    let end = async {
        worker.write_all(last_output).await.unwrap();
        if lets_go {
            drop(worker);
        } else {
            std::mem::forget(worker);
        }
        End::Broken("it ended".to_owned())
    };
    assert_eq!(with_output(end, &mut log, Some(output)).await, End::Broken("it ended".to_owned()));
    log::read(dir.path(), &job, u64::MAX).await.unwrap()
}

#[tokio::test]
async fn the_last_output_of_a_worker_is_kept() {
    assert_eq!(log_of(b"one\nlast", true).await, "one\nlast\n");
    assert_eq!(log_of(b"", true).await, "");
}

#[tokio::test]
async fn a_pipe_that_stays_open_is_not_waited_for() {
    assert_eq!(log_of(b"one\nhalf", false).await, "one\n");
}
