//! Encoders: results of pretraining.

use sqlx::{Sqlite, Transaction};

use super::{Store, fault, row};
use crate::{
    domain::{
        id::EncoderId,
        job::{JobKind, JobSpec},
        score::Encoder,
        time::Millis,
    },
    error::{Error, Result},
};

#[derive(sqlx::FromRow)]
struct EncoderRow {
    id: String,
    task_id: String,
    job_id: String,
    snapshot_id: String,
    checkpoint: String,
    created_at: i64,
}

impl EncoderRow {
    fn encoder(self) -> Result<Encoder> {
        Ok(Encoder {
            id: row::id("encoders.id", self.id)?,
            task_id: row::id("encoders.task_id", self.task_id)?,
            job_id: row::id("encoders.job_id", self.job_id)?,
            snapshot_id: row::id("encoders.snapshot_id", self.snapshot_id)?,
            checkpoint: row::id("encoders.checkpoint", self.checkpoint)?,
            created_at: Millis(self.created_at),
        })
    }
}

/// Adds a finished encoder.
pub(super) async fn insert(tx: &mut Transaction<'_, Sqlite>, encoder: &Encoder) -> Result<()> {
    sqlx::query(
        "insert into encoders (id, task_id, job_id, snapshot_id, checkpoint, created_at) values (?, ?, ?, ?, ?, ?)",
    )
    .bind(encoder.id.as_str())
    .bind(encoder.task_id.as_str())
    .bind(encoder.job_id.as_str())
    .bind(encoder.snapshot_id.as_str())
    .bind(encoder.checkpoint.as_str())
    .bind(encoder.created_at.0)
    .execute(&mut **tx)
    .await
    .map_err(fault("adding an encoder"))?;
    Ok(())
}

impl Store {
    /// A finished encoder.
    ///
    /// # Errors
    /// NotFound, or Precondition naming its job when that has not succeeded.
    pub(crate) async fn encoder(&self, id: &EncoderId) -> Result<Encoder> {
        let found: Option<EncoderRow> = sqlx::query_as("select * from encoders where id = ?")
            .bind(id.as_str())
            .fetch_optional(self.read())
            .await
            .map_err(fault("reading an encoder"))?;
        match found {
            Some(found) => found.encoder(),
            None => Err(self.missing(JobKind::Pretrain, "encoder", id.as_str()).await),
        }
    }

    /// The encoder's l: a segment is the window of l + 1 steps that ends at its step.
    ///
    /// # Errors
    /// As for [`Store::encoder`].
    pub(crate) async fn segment_length(&self, id: &EncoderId) -> Result<u32> {
        let encoder = self.encoder(id).await?;
        match self.job(&encoder.job_id).await?.spec {
            JobSpec::Pretrain { spec, .. } => Ok(spec.model.segment_length),
            JobSpec::Score { .. } | JobSpec::Train { .. } | JobSpec::Export { .. } | JobSpec::Evaluate { .. } => {
                Err(Error::internal("reading an encoder's spec", "its job is not a pretraining job"))
            }
        }
    }
}
