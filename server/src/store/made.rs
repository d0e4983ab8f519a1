//! Results that jobs make: why one is not there (yet).

use super::{Store, fault};
use crate::{
    domain::{
        id::TaskId,
        job::{JobKind, JobState},
    },
    error::{Error, Result},
};

/// The job that makes a result.
pub(super) struct Maker {
    pub(super) job_id: String,
    pub(super) task_id: TaskId,
    pub(super) state: JobState,
    pub(super) error: String,
}

impl Maker {
    /// Says that the result will never be there, if its job gave up.
    pub(super) fn refuse_if_given_up(&self, what: &str, id: &str) -> Result<()> {
        match self.state {
            JobState::Failed => Err(Error::precondition(format!(
                "{what} {id} was never made: {} failed: {}; submit it again",
                self.job_id, self.error
            ))),
            JobState::Cancelled => Err(Error::precondition(format!(
                "{what} {id} was never made: {} was cancelled; submit it again",
                self.job_id
            ))),
            JobState::Queued | JobState::Running | JobState::Succeeded => Ok(()),
        }
    }
}

impl Store {
    /// The job of this kind that makes the result `id`.
    pub(super) async fn maker(&self, kind: JobKind, id: &str) -> Result<Option<Maker>> {
        let row: Option<(String, String, String, String)> =
            sqlx::query_as("select id, task_id, state, error from jobs where result_id = ? and kind = ?")
                .bind(id)
                .bind(kind.as_str())
                .fetch_optional(self.read())
                .await
                .map_err(fault("looking for the job of a result"))?;
        row.map(|(job_id, task_id, state, error)| {
            Ok(Maker {
                job_id,
                task_id: super::row::id("jobs.task_id", task_id)?,
                state: super::row::parsed("jobs.state", JobState::from_word(&state))?,
                error,
            })
        })
        .transpose()
    }

    /// The error for a result that has no row: unknown, not finished, or given up.
    pub(super) async fn missing(&self, kind: JobKind, what: &str, id: &str) -> Error {
        match self.maker(kind, id).await {
            Ok(None) => Error::not_found(what, id),
            Err(error) => error,
            Ok(Some(maker)) => match maker.refuse_if_given_up(what, id) {
                Err(error) => error,
                Ok(()) => Error::precondition(format!(
                    "{what} {id} is not finished: {} is {}; watch that job",
                    maker.job_id,
                    maker.state.as_str()
                )),
            },
        }
    }
}
