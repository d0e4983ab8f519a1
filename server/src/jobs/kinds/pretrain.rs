//! Pretraining: a snapshot in, an encoder out.

use gleaner_core::PretrainSpec;

use super::{Resolved, result_id};
use crate::{
    domain::{
        id::{BlobId, EncoderId, SnapshotId, TaskId},
        job::{Job, JobSpec},
        score::Encoder,
        snapshot::RoleRule,
        time::Millis,
    },
    error::Result,
    jobs::Jobs,
    store::finish::JobResult,
};

/// Without a snapshot, a new one is taken under the rule.
pub(super) async fn resolve(
    jobs: &Jobs,
    task: &TaskId,
    snapshot_id: Option<SnapshotId>,
    rule: &RoleRule,
    spec: PretrainSpec,
) -> Result<Resolved> {
    let snapshot_id = jobs.snapshot(task, "spec.pretrain.snapshot_id", snapshot_id, rule).await?;
    Ok(Resolved::new(JobSpec::Pretrain { snapshot_id, spec }, None))
}

pub(super) fn accept(job: &Job, snapshot_id: &SnapshotId, checkpoint: BlobId) -> Result<JobResult> {
    Ok(JobResult::Encoder(Encoder {
        id: result_id(job, EncoderId::try_from)?,
        task_id: job.task_id.clone(),
        job_id: job.id.clone(),
        snapshot_id: snapshot_id.clone(),
        checkpoint,
        created_at: Millis::now(),
    }))
}
