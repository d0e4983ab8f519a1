//! Calls of running workers: authentication, progress, checkpoints, and the end of the attempt.

use std::{net::SocketAddr, time::Duration};

use super::{Jobs, kinds, token};
use crate::{
    domain::{
        attempt::{Attempt, AttemptEnd},
        id::BlobId,
        job::Job,
        work::{Made, Progress},
    },
    error::{Error, Kind, Result},
    store::attempt::Claimant,
};

/// The longest wait for the address of a meeting within one call.
const MEETING_WAIT: Duration = Duration::from_secs(10);

/// What a worker says of itself in each call.
pub(crate) struct Caller<'a> {
    /// Random characters that identify its process.
    pub(crate) process: &'a str,
    /// Its node of a cluster; empty elsewhere.
    pub(crate) node: &'a str,
    /// Its number among the processes of its attempt.
    pub(crate) rank: u32,
}

impl Jobs {
    /// The running attempt that a token proves, with its job; `None` for any other token, and for every process but the
    /// first that presents it as its rank. A call of rank 0 counts as a sign of life, and its first one records the
    /// worker's node.
    ///
    /// # Errors
    /// When the database fails.
    pub(crate) async fn authenticate(&self, token: &str, caller: &Caller<'_>) -> Result<Option<(Attempt, Job)>> {
        let Some(attempt) = token::attempt(token) else { return Ok(None) };
        let Caller { process, node, rank } = *caller;
        // Rank 0 is bound in the row, because it alone can change anything. The others read only, so a lease suffices.
        let claimant = match rank {
            0 => self.0.store.claimant(&attempt, process, node).await.inspect_err(|error| {
                // A worker that calls is alive, also while the database is away.
                if error.kind() == Kind::Unavailable {
                    self.0.leases.renew(&attempt);
                }
            })?,
            _ => match self.0.store.running_job(&attempt).await? {
                Some(job) if self.0.leases.admit(&attempt, rank, process) => Claimant::Worker(Box::new(job)),
                Some(_) => Claimant::Other,
                None => Claimant::Over,
            },
        };
        match claimant {
            Claimant::Worker(job) if rank > 0 => Ok(Some((attempt, *job))),
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

    /// Records where rank 0 of an attempt waits for the others.
    pub(crate) fn report_meeting(&self, attempt: &Attempt, address: SocketAddr) {
        self.0.leases.meet(attempt, address);
    }

    /// Where rank 0 of an attempt waits for the others; `None` if it has not reported after some seconds. The address is
    /// in memory only: ranks that meet while the server restarts fail, and the next attempt follows.
    pub(crate) async fn meeting(&self, attempt: &Attempt) -> Option<SocketAddr> {
        tokio::time::timeout(MEETING_WAIT, self.0.leases.meeting(attempt)).await.ok()
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
        self.expect_blob(blob).await?;
        let before = self.0.store.save_checkpoint(attempt, step, blob).await?;
        drop(naming);
        if let Some(before) = before {
            self.0.forget(before).await;
            crate::fail_point::pass("checkpoint.earlier_forgotten");
        }
        Ok(())
    }

    /// Records that the worker of an attempt is alive: it sends a part of its result.
    pub(crate) fn renew(&self, attempt: &Attempt) {
        self.0.leases.renew(attempt);
    }

    /// Ends the job with its result. The scores of a large run take long to store, while the worker waits.
    ///
    /// # Errors
    /// Invalid when the result does not fit the job; NotFound when a blob does not exist; Precondition when the attempt
    /// has ended; Cancelled when the job was cancelled in the meantime.
    pub(crate) async fn complete(&self, attempt: &Attempt, job: &Job, made: Made) -> Result<()> {
        self.0.leases.renew_during(attempt, self.store_result(attempt, job, made)).await
    }

    async fn store_result(&self, attempt: &Attempt, job: &Job, made: Made) -> Result<()> {
        let naming = self.0.blobs.naming().await;
        for blob in kinds::blobs(&made) {
            self.expect_blob(blob).await?;
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

    async fn expect_blob(&self, blob: &BlobId) -> Result<()> {
        let (blobs, id) = (self.0.blobs.clone(), blob.clone());
        let looking = tokio::task::spawn_blocking(move || blobs.size(&id)).await;
        let found = looking.map_err(|error| Error::internal("looking for a blob", error))??;
        found.map(drop).ok_or_else(|| Error::not_found("blob", blob))
    }
}

#[cfg(test)]
mod tests;
