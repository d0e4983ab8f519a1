//! Lookup of the objects that orders name: snapshots, encoders and datasets of one task, with the jobs that make them.

use super::Jobs;
use crate::{
    domain::{
        id::{DatasetId, EncoderId, JobId, SnapshotId, TaskId},
        job::{Job, JobSpec},
        snapshot::RoleRule,
    },
    error::{Error, Result},
};

impl Jobs {
    /// The named snapshot, or a new one under the rule.
    pub(super) async fn snapshot(
        &self,
        task: &TaskId,
        field: &str,
        named: Option<SnapshotId>,
        rule: &RoleRule,
    ) -> Result<SnapshotId> {
        let Some(id) = named else {
            return Ok(self.0.store.create_snapshot(task, rule).await?.id);
        };
        let snapshot = self.0.store.frozen(&id).await?;
        same_task(field, id.as_str(), &snapshot.task_id, task)?;
        self.0.store.expect_recordings(&id).await?;
        Ok(id)
    }

    /// The snapshot that a scoring names, or the task's present episodes under the rule of an earlier one.
    pub(super) async fn scored_snapshot(
        &self,
        task: &TaskId,
        named: Option<SnapshotId>,
        earlier: &SnapshotId,
    ) -> Result<SnapshotId> {
        match named {
            Some(id) => self.snapshot(task, "spec.score.snapshot_id", Some(id), &RoleRule::default()).await,
            None => self.0.store.renewed_snapshot(earlier).await,
        }
    }

    /// The job that makes an encoder, and the encoder's snapshot, of which recordings may have been deleted since.
    pub(super) async fn encoder(&self, task: &TaskId, field: &str, id: &EncoderId) -> Result<(JobId, SnapshotId)> {
        match self.0.store.job_of_result(id.as_str()).await? {
            Some(Job { id: maker, task_id, spec: JobSpec::Pretrain { snapshot_id, .. }, .. }) => {
                same_task(field, id.as_str(), &task_id, task)?;
                Ok((maker, snapshot_id))
            }
            Some(_) | None => Err(Error::not_found("encoder", id)),
        }
    }

    /// The job that makes a dataset's scores, and the encoder and snapshot of those scores. Imported scores have no job, and
    /// may have no encoder.
    pub(super) async fn dataset(
        &self,
        task: &TaskId,
        field: &str,
        id: &DatasetId,
    ) -> Result<(Option<JobId>, Option<EncoderId>, SnapshotId)> {
        let dataset = self.0.store.dataset(id).await?;
        same_task(field, id.as_str(), &dataset.task_id, task)?;
        if let Some(run) = self.0.store.imported(&dataset.score_run_id).await? {
            self.0.store.expect_recordings(&run.snapshot_id).await?;
            return Ok((None, run.origin.encoder_id().cloned(), run.snapshot_id));
        }
        match self.0.store.job_of_result(dataset.score_run_id.as_str()).await? {
            Some(Job { id: maker, spec: JobSpec::Score { encoder_id, snapshot_id, .. }, .. }) => {
                self.0.store.expect_recordings(&snapshot_id).await?;
                Ok((Some(maker), Some(encoder_id), snapshot_id))
            }
            Some(_) | None => Err(Error::not_found("score run", &dataset.score_run_id)),
        }
    }
}

/// Fails unless `found` is the task of the order.
pub(super) fn same_task(field: &str, id: &str, found: &TaskId, task: &TaskId) -> Result<()> {
    if found == task {
        return Ok(());
    }
    Err(Error::invalid(field, format!("{id} belongs to {found}, not to {task}; name one of this task")))
}
