//! The amount of waiting work, for monitoring.

use super::{Store, fault, row, sql};
use crate::{
    domain::{job::JobState, time::Millis},
    error::Result,
};

/// Counts of jobs.
#[derive(Debug, Default)]
pub(crate) struct Backlog {
    /// Jobs in each state that has any.
    pub(crate) jobs: Vec<(JobState, u64)>,
    /// When the oldest queued job was queued.
    pub(crate) oldest_queued: Option<Millis>,
}

impl Store {
    /// Counts the jobs.
    pub(crate) async fn backlog(&self) -> Result<Backlog> {
        let counts: Vec<(JobState, u64, Millis)> =
            sql::query("select state, count(*), min(created_at) from jobs group by state")
                .try_map(row::read)
                .fetch_all(self.read())
                .await
                .map_err(fault("counting jobs"))?;
        let mut backlog = Backlog::default();
        for (state, count, oldest) in counts {
            if state == JobState::Queued {
                backlog.oldest_queued = Some(oldest);
            }
            backlog.jobs.push((state, count));
        }
        Ok(backlog)
    }
}
