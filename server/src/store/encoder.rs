//! Encoders: results of pretraining.

use super::{
    Store, fault,
    row::{self, Column as _, record},
    sql::{self, Transaction},
};
use crate::{
    domain::{
        id::EncoderId,
        job::{JobKind, JobSpec},
        score::Encoder,
    },
    error::{Error, Result},
};

record! { Encoder: id, task_id, job_id, snapshot_id, checkpoint, created_at }

/// Adds a finished encoder.
pub(super) async fn insert(tx: &mut Transaction, encoder: &Encoder) -> Result<()> {
    sql::query(
        "insert into encoders (id, task_id, job_id, snapshot_id, checkpoint, created_at) values ($1, $2, $3, $4, $5, $6)",
    )
    .bind(encoder.id.param())
    .bind(encoder.task_id.param())
    .bind(encoder.job_id.param())
    .bind(encoder.snapshot_id.param())
    .bind(encoder.checkpoint.param())
    .bind(encoder.created_at.param())
    .execute(&mut *tx)
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
        let found = sql::query("select * from encoders where id = $1")
            .bind(id.param())
            .try_map(row::read)
            .fetch_optional(self.read())
            .await
            .map_err(fault("reading an encoder"))?;
        match found {
            Some(found) => Ok(found),
            None => Err(self.missing(JobKind::Pretrain, "encoder", id.as_str()).await),
        }
    }

    /// The encoder's l: a segment is the window of l + 1 steps that ends at its step. Without an encoder l is 0: a segment
    /// is its step.
    ///
    /// # Errors
    /// As for [`Store::encoder`].
    pub(crate) async fn segment_length(&self, id: Option<&EncoderId>) -> Result<u32> {
        let Some(id) = id else { return Ok(0) };
        let encoder = self.encoder(id).await?;
        match self.job(&encoder.job_id).await?.spec {
            JobSpec::Pretrain { spec, .. } => Ok(spec.model.segment_length),
            JobSpec::Score { .. } | JobSpec::Train { .. } | JobSpec::Export { .. } | JobSpec::Evaluate { .. } => {
                Err(Error::internal("reading an encoder's spec", "its job is not a pretraining job"))
            }
        }
    }
}
