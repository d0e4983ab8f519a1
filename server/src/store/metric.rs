//! What running jobs report: progress on the job's row, and a row for each metric.

use sqlx::{Sqlite, Transaction};

use super::{Store, commit, fault, queue, row};
use crate::{
    domain::{attempt::Attempt, id::JobId, job::Metric, work::Progress},
    error::Result,
};

impl Store {
    /// Keeps what a worker reports; the answer says whether somebody asked the job to stop.
    ///
    /// # Errors
    /// Precondition when the attempt is over.
    pub(crate) async fn report_progress(&self, attempt: &Attempt, progress: &Progress) -> Result<bool> {
        let mut tx = self.write().await?;
        let job = queue::running(&mut tx, attempt).await?.ok_or_else(queue::attempt_is_over)?;
        sqlx::query(
            "update jobs set done = ?1, total = ?2, message = iif(cancel_requested, message, ?3), \
             peak_memory_bytes = max(peak_memory_bytes, ?4) where id = ?5",
        )
        .bind(row::stored(progress.done))
        .bind(row::stored(progress.total))
        .bind(&progress.message)
        .bind(row::stored(progress.peak_memory_bytes))
        .bind(job.id.as_str())
        .execute(&mut *tx)
        .await
        .map_err(fault("keeping progress"))?;
        for (step, name, value) in &progress.metrics {
            sqlx::query("insert into job_metrics (job_id, step, name, value) values (?, ?, ?, ?)")
                .bind(job.id.as_str())
                .bind(row::stored(*step))
                .bind(name)
                .bind(value)
                .execute(&mut *tx)
                .await
                .map_err(fault("keeping a metric"))?;
        }
        crate::fail_point::pass("progress.rows_written");
        commit(tx).await?;
        crate::fail_point::pass("progress.committed");
        Ok(job.cancel_requested)
    }

    /// At most `limit` metrics of a job that arrived after `sequence`, in order of arrival.
    pub(crate) async fn metrics(&self, job: &JobId, sequence: i64, limit: u32) -> Result<Vec<Metric>> {
        let rows: Vec<(i64, i64, String, f64)> = sqlx::query_as(
            "select id, step, name, value from job_metrics where job_id = ? and id > ? order by id limit ?",
        )
        .bind(job.as_str())
        .bind(sequence)
        .bind(limit)
        .fetch_all(self.read())
        .await
        .map_err(fault("reading metrics"))?;
        rows.into_iter()
            .map(|(sequence, step, name, value)| {
                Ok(Metric { sequence, step: row::count("job_metrics.step", step)?, name, value })
            })
            .collect()
    }
}

/// Forgets the metrics of steps that the next attempt will do again.
pub(super) async fn cut_back(
    tx: &mut Transaction<'_, Sqlite>,
    job: &JobId,
    checkpoint_step: Option<u64>,
) -> Result<()> {
    sqlx::query("delete from job_metrics where job_id = ? and step > ?")
        .bind(job.as_str())
        .bind(checkpoint_step.map_or(-1, row::stored))
        .execute(&mut **tx)
        .await
        .map_err(fault("cutting metrics back"))?;
    Ok(())
}
