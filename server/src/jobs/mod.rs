//! The job queue, the supervisor of worker processes, and the scheduler.
//!
//! Uses rows through `store` and files through `blobs`; must not depend on gRPC or tensors.

mod assignment;
mod attempt;
mod blobs;
mod chain;
mod engine;
mod image_weights;
mod input_episodes;
mod kinds;
mod lease;
mod log;
mod lookup;
mod report;
mod resume;
mod retry;
mod scheduler;
mod start;
mod submit;
mod supervisor;
#[cfg(test)]
mod testing;
#[cfg(test)]
mod tests;
mod token;
mod watch;

use std::{net::SocketAddr, sync::Arc, time::Duration};

use tokio::sync::{Notify, Semaphore, watch as state};
use tokio_util::{sync::CancellationToken, task::TaskTracker};

pub(crate) use self::{blobs::Located, report::Caller};
use self::{
    engine::{Engine, Local, Slurm},
    lease::Leases,
};
use crate::{
    blobs::Blobs,
    config::{EngineKind, ServeConfig},
    domain::{
        attempt::{Attempt, AttemptEnd},
        id::{BlobId, JobId, ScheduleId},
        job::Job,
        schedule::Schedule,
        time::Millis,
    },
    error::Result,
    maintenance,
    store::{Store, queue::Moved},
};

/// Interval of retries to store an attempt's end.
#[cfg(not(test))]
const AGAIN_AFTER: Duration = Duration::from_secs(5);
#[cfg(test)]
const AGAIN_AFTER: Duration = Duration::from_millis(5);

/// Handle to the queue; clones share it.
#[derive(Clone)]
pub struct Jobs(Arc<Inner>);

/// The shared state of the queue's tasks.
struct Inner {
    config: Arc<ServeConfig>,
    store: Store,
    blobs: Blobs,
    /// Where workers run.
    engine: Box<dyn Engine>,
    /// One permit for each attempt that may run at once.
    slots: Arc<Semaphore>,
    /// Notified when a job may have become ready to run.
    ready: Notify,
    /// Notified when a schedule may have become due.
    due: Notify,
    /// Marked whenever any job or metric changes; watchers then read theirs again.
    changed: state::Sender<()>,
    /// Attempts whose worker processes this server runs.
    leases: Leases,
    /// Cancelled when the server stops.
    stopping: CancellationToken,
    tasks: TaskTracker,
}

impl Jobs {
    /// Resumes or ends the attempts of an earlier server, then starts the supervisor and the scheduler.
    ///
    /// # Errors
    /// When the database cannot be read, or a file that a flag of the engine names.
    pub async fn start(config: &Arc<ServeConfig>, store: Store, blobs: Blobs, server: SocketAddr) -> Result<Self> {
        let jobs = Self::new(config, store, blobs, server)?;
        jobs.begin().await?;
        Ok(jobs)
    }

    /// The queue without a supervisor: a standby leaves its jobs to the leader.
    ///
    /// # Errors
    /// When a file that a flag of the engine names cannot be read.
    pub(crate) fn new(config: &Arc<ServeConfig>, store: Store, blobs: Blobs, server: SocketAddr) -> Result<Self> {
        let stopping = CancellationToken::new();
        let engine: Box<dyn Engine> = match config.jobs.engine.engine {
            EngineKind::Local => Box::new(Local::new(Arc::clone(config), server)),
            EngineKind::Slurm => Box::new(Slurm::new(Arc::clone(config))?),
        };
        Ok(Self(Arc::new(Inner {
            config: Arc::clone(config),
            store,
            blobs,
            engine,
            slots: Arc::new(Semaphore::new(config.jobs.workers)),
            ready: Notify::new(),
            due: Notify::new(),
            changed: state::Sender::new(()),
            leases: Leases::new(stopping.clone()),
            stopping,
            tasks: TaskTracker::new(),
        })))
    }

    /// Resumes or ends the attempts of an earlier server, then starts the supervisor and the scheduler.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub(crate) async fn begin(&self) -> Result<()> {
        let inner = &self.0;
        resume::resume(inner).await?;
        inner.tasks.spawn(supervisor::supervise(Arc::clone(inner)));
        inner.tasks.spawn(scheduler::schedule(Arc::clone(inner)));
        Ok(())
    }

    /// Rejects workers unless this server leads: on a standby no attempt is over.
    ///
    /// # Errors
    /// As [`Store::expect_leader`].
    pub(crate) fn expect_leader(&self) -> Result<()> {
        self.0.store.expect_leader()
    }

    /// Notifies watchers that another server may have changed jobs.
    pub(crate) fn changed_elsewhere(&self) {
        self.0.changed.send_replace(());
    }

    /// Requests the workers to stop, kills those that do not, and waits. Their jobs return to the queue, and the
    /// attempts are not counted. Workers that outlive the server continue. Must be called while workers can still reach the server.
    pub async fn stop(&self) {
        self.0.stopping.cancel();
        self.0.tasks.close();
        self.0.tasks.wait().await;
    }

    /// Notifies the scheduler that an episode was labelled or uploaded.
    pub fn labelled(&self) {
        self.0.due.notify_one();
    }

    /// Cancels a job, and the jobs that wait for it. A running job ends once its worker has ended.
    ///
    /// # Errors
    /// NotFound; Precondition when it has ended.
    pub(crate) async fn cancel(&self, id: &JobId) -> Result<Job> {
        let moved = self.0.store.cancel_job(id).await?;
        self.0.leases.stop(id);
        self.0.settle(moved).await
    }

    /// The end of the log of a job's workers, of about `most` bytes at most: lines of text, the newest last.
    ///
    /// # Errors
    /// Internal when the disk fails.
    pub(crate) async fn log(&self, id: &JobId, most: u64) -> Result<String> {
        log::read(&self.0.config.data_dir, id, most).await
    }

    /// Stores a new schedule.
    ///
    /// # Errors
    /// Exists when the task has a schedule of this name; Precondition for options of an engine that has none and for image
    /// weights that the server lacks; Invalid for a pipeline with trials of a task that cannot be simulated.
    pub(crate) async fn add_schedule(&self, schedule: &Schedule) -> Result<Schedule> {
        self.accept_options(&schedule.engine_options)?;
        self.startable(&schedule.task_id, schedule.pipeline()?).await?;
        let added = self.0.store.insert_schedule(schedule).await?;
        self.0.due.notify_one();
        Ok(added)
    }

    /// Pauses or resumes a schedule. Starts missed during the pause are not made up for.
    ///
    /// # Errors
    /// NotFound.
    pub(crate) async fn pause_schedule(&self, id: &ScheduleId, paused: bool) -> Result<Schedule> {
        let schedule = self.0.store.schedule(id).await?;
        let next = if paused { None } else { schedule.trigger.next_run("cron", Millis::now())? };
        let schedule = self.0.store.pause_schedule(id, paused, next).await?;
        self.0.due.notify_one();
        Ok(schedule)
    }
}

impl Inner {
    /// Ends an attempt, unless it has ended, and retries for as long as the database rejects the write, because the job
    /// would otherwise stay in the state running. If the server stops first, its next start ends the attempt.
    async fn end_with_retries(&self, attempt: &Attempt, end: &AttemptEnd) {
        while let Err(error) = self.end_attempt(attempt, end).await {
            tracing::error!(job.id = %attempt.job_id, %error, "the end of an attempt cannot be stored; retrying");
            if self.stopping.run_until_cancelled(tokio::time::sleep(AGAIN_AFTER)).await.is_none() {
                return;
            }
        }
    }

    /// Ends an attempt, unless it has already ended.
    async fn end_attempt(&self, attempt: &Attempt, end: &AttemptEnd) -> Result<()> {
        if let Some(moved) = self.store.end_attempt(attempt, end).await? {
            let job = self.settle(moved).await?;
            tracing::info!(
                job.id = %job.id, job.state = job.state.as_str(), job.attempt = job.attempt,
                job.message = job.message, job.error = job.error, "attempt ended"
            );
        }
        Ok(())
    }

    /// Follows up a change of a job's state: notifies watchers and the supervisor, and removes a blob that no row names
    /// any more.
    async fn settle(&self, moved: Moved) -> Result<Job> {
        self.changed.send_replace(());
        self.ready.notify_one();
        if let Some(blob) = moved.dropped {
            self.forget(blob).await;
        }
        Ok(moved.job)
    }

    /// Removes a blob unless a row names it. A failure is only logged: the blob takes space until the sweep removes it.
    async fn forget(&self, blob: BlobId) {
        if let Err(error) = maintenance::forget(&self.store, &self.blobs, &blob).await {
            tracing::warn!(blob.id = %blob, %error, "an unneeded checkpoint cannot be removed");
        }
    }
}
