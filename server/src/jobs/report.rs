//! Calls of running workers: authentication, progress, checkpoints, and the end of the attempt.

use super::{Jobs, kinds, token};
use crate::{
    domain::{
        attempt::{Attempt, AttemptEnd},
        id::BlobId,
        job::Job,
        work::{Made, Progress},
    },
    error::{Error, Result},
    store::attempt::Claimant,
};

impl Jobs {
    /// The running attempt that a token proves, with its job; `None` for any other token, and for every process but the
    /// first that presents it. Counts as a sign of life. The first call of an attempt records the worker's node.
    ///
    /// # Errors
    /// When the database fails.
    pub(crate) async fn authenticate(&self, token: &str, process: &str, node: &str) -> Result<Option<(Attempt, Job)>> {
        let Some(attempt) = token::attempt(token) else { return Ok(None) };
        match self.0.store.claimant(&attempt, process, node).await? {
            Claimant::Worker(job) => {
                self.0.leases.renew(&attempt);
                Ok(Some((attempt, *job)))
            }
            Claimant::Other => {
                tracing::warn!(job.id = %attempt.job_id, "a second process called for an attempt and was rejected");
                self.0.leases.contest(&attempt);
                Ok(None)
            }
            Claimant::Over => Ok(None),
        }
    }

    /// Stores progress; returns whether to stop.
    ///
    /// # Errors
    /// Precondition when the attempt has ended.
    pub(crate) async fn progress(&self, attempt: &Attempt, progress: &Progress) -> Result<bool> {
        let cancelled = self.0.store.report_progress(attempt, progress).await?;
        self.0.changed.send_replace(());
        if cancelled {
            // The job may have been cancelled between the claim and the lease; from here on the stop has a deadline.
            self.0.leases.stop(&attempt.job_id);
        }
        Ok(cancelled || self.0.leases.stopped(attempt))
    }

    /// Names the blob to resume from, then removes the one before it.
    ///
    /// # Errors
    /// NotFound when the blob does not exist; Precondition when the attempt has ended.
    pub(crate) async fn checkpoint(&self, attempt: &Attempt, step: u64, blob: &BlobId) -> Result<()> {
        let naming = self.0.blobs.naming().await;
        self.expect_blob(blob)?;
        let before = self.0.store.save_checkpoint(attempt, step, blob).await?;
        drop(naming);
        if let Some(before) = before {
            self.0.forget(before).await;
            crate::fail_point::pass("checkpoint.earlier_forgotten");
        }
        Ok(())
    }

    /// Ends the job with its result.
    ///
    /// # Errors
    /// Invalid when the result does not fit the job; NotFound when a blob does not exist; Precondition when the attempt
    /// has ended; Cancelled when the job was cancelled in the meantime.
    pub(crate) async fn complete(&self, attempt: &Attempt, job: &Job, made: Made) -> Result<()> {
        let naming = self.0.blobs.naming().await;
        for blob in kinds::blobs(&made) {
            self.expect_blob(blob)?;
        }
        let result = kinds::accept(&self.0.store, job, made).await?;
        let moved = self.0.store.finish_job(attempt, &result).await?;
        drop(naming);
        self.0.leases.deliver(attempt);
        let job = self.0.settle(moved).await?;
        tracing::info!(job.id = %job.id, result.id = job.result_id, "job succeeded");
        Ok(())
    }

    /// Ends an attempt with an error.
    ///
    /// # Errors
    /// When the database fails.
    pub(crate) async fn fail(&self, attempt: &Attempt, error: String, retry: bool) -> Result<()> {
        // On a full disk no attempt can succeed, and the attempt does not count: the job waits in the queue.
        let end = if self.0.leases.stopped(attempt) || self.0.blobs.is_full() {
            AttemptEnd::Stopped
        } else if retry {
            AttemptEnd::Broken(error)
        } else {
            AttemptEnd::Permanent(error)
        };
        self.0.end_attempt(attempt, &end).await?;
        self.0.leases.deliver(attempt);
        Ok(())
    }

    fn expect_blob(&self, blob: &BlobId) -> Result<()> {
        if self.0.blobs.contains(blob) { Ok(()) } else { Err(Error::not_found("blob", blob)) }
    }
}
