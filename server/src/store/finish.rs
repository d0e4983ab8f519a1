//! The success of a job: its result's rows and its new state, in one transaction.

use super::{Store, attempt, encoder, evaluation, export, policy, queue, score};
use crate::{
    domain::{
        attempt::Attempt,
        dataset::ExportFile,
        evaluation::Evaluation,
        id::{DatasetId, ExportId},
        job::JobState,
        policy::Policy,
        score::{Encoder, EpisodeScores, ScoreRun},
    },
    error::{Error, Result},
};

/// The rows a job leaves.
#[derive(Debug)]
pub(crate) enum JobResult {
    /// The result of pretraining.
    Encoder(Encoder),
    /// The result of scoring, with the episodes' scores in the snapshot's order.
    Scores(Box<ScoreRun>, Vec<EpisodeScores>),
    /// The result of training.
    Policy(Policy),
    /// The result of exporting.
    Export(ExportId, DatasetId, Vec<ExportFile>),
    /// The result of evaluating.
    Evaluation(Evaluation),
}

impl Store {
    /// Ends an attempt with its result.
    ///
    /// # Errors
    /// Precondition when the attempt has ended; Cancelled when the job was asked to stop.
    pub(crate) async fn finish_job(&self, attempt: &Attempt, result: &JobResult) -> Result<queue::Moved> {
        let mut tx = self.write().await?;
        let job = attempt::running(&mut tx, attempt).await?.ok_or_else(attempt::attempt_is_over)?;
        if job.cancel_requested {
            return Err(Error::cancelled(format!("{} was cancelled", job.id)));
        }
        match result {
            JobResult::Encoder(made) => encoder::insert(&mut tx, made).await?,
            JobResult::Scores(run, episodes) => score::insert_run(&mut tx, run, None, episodes).await?,
            JobResult::Policy(policy) => policy::insert(&mut tx, policy).await?,
            JobResult::Export(id, dataset, files) => {
                export::insert(&mut tx, id, dataset, &job.id, files).await?;
            }
            JobResult::Evaluation(evaluation) => evaluation::insert(&mut tx, evaluation).await?,
        }
        let moved = queue::advance(&mut tx, &job, JobState::Succeeded, "done", "").await?;
        crate::fail_point::pass("result.rows_written");
        self.commit_generation(tx).await?;
        crate::fail_point::pass("result.committed");
        Ok(moved)
    }
}
