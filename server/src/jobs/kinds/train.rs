//! Training: experts, and perhaps a dataset and an encoder, in; a policy out.

use gleaner_core::TrainSpec;

use super::{Resolved, result_id};
use crate::{
    domain::{
        id::{BlobId, DatasetId, EncoderId, JobId, PolicyId, SnapshotId, TaskId},
        job::{Job, JobSpec},
        order::{TrainData, needs_encoder},
        policy::{Policy, PolicyOrigin, Training},
        snapshot::{Role, RoleRule},
        time::Millis,
        work::Inputs,
    },
    error::{Error, Result},
    jobs::{Jobs, input_episodes::Source},
    store::{KeptDetail, finish::JobResult},
};

pub(super) async fn resolve(jobs: &Jobs, task: &TaskId, data: TrainData, spec: TrainSpec) -> Result<Resolved> {
    let scratch = !needs_encoder(&spec);
    let (maker, encoder_id, snapshot_id, dataset_id) = learned_from(jobs, task, data, scratch).await?;
    Ok(Resolved::new(JobSpec::Train { encoder_id, snapshot_id, dataset_id, spec }, maker))
}

/// The inputs of a training: the job to wait for, the encoder to start from, the experts' snapshot, the dataset. A
/// policy from scratch has no encoder, and with experts alone no job to wait for.
async fn learned_from(
    jobs: &Jobs,
    task: &TaskId,
    data: TrainData,
    scratch: bool,
) -> Result<(Option<JobId>, Option<EncoderId>, SnapshotId, Option<DatasetId>)> {
    match data {
        TrainData::ExpertsOf(encoder) => {
            let (maker, snapshot) = jobs.encoder(task, "spec.train.experts_of", &encoder).await?;
            jobs.0.store.expect_recordings(&snapshot).await?;
            Ok(if scratch { (None, None, snapshot, None) } else { (Some(maker), Some(encoder), snapshot, None) })
        }
        TrainData::ExpertsIn(id) => {
            let snapshot = jobs.snapshot(task, "spec.train.experts_in", Some(id), &RoleRule::default()).await?;
            Ok((None, None, snapshot, None))
        }
        TrainData::Dataset(dataset) => {
            let (maker, encoder, snapshot) = jobs.dataset(task, "spec.train.dataset_id", &dataset).await?;
            if !scratch && encoder.is_none() {
                return Err(Error::precondition(format!(
                    "spec.train.dataset_id: the scores of {dataset} were imported without an encoder, which this policy \
                     starts from; import them again with an encoder_id, or train a policy from scratch, such as bc"
                )));
            }
            let encoder = encoder.filter(|_| !scratch);
            if let Some(encoder) = &encoder {
                expect_trained(jobs, &dataset, encoder).await?;
            }
            Ok((maker, encoder, snapshot, Some(dataset)))
        }
    }
}

/// Fails if the scores of a dataset name an encoder that has learned nothing, which a scorer that reads none leaves.
async fn expect_trained(jobs: &Jobs, dataset: &DatasetId, encoder: &EncoderId) -> Result<()> {
    match jobs.0.store.job_of_result(encoder.as_str()).await? {
        Some(Job { spec: JobSpec::Pretrain { spec, .. }, .. }) if spec.is_untrained() => {
            Err(Error::precondition(format!(
                "spec.train.dataset_id: {dataset} was scored with an encoder of one step, which this policy would begin \
                 with; train a policy from scratch, such as bc, or pretrain an encoder and score with it"
            )))
        }
        Some(_) | None => Ok(()),
    }
}

pub(super) async fn inputs(jobs: &Jobs, encoder: Option<&EncoderId>, inputs: &mut Inputs) -> Result<()> {
    if let Some(encoder) = encoder {
        inputs.encoder = Some(jobs.0.store.encoder(encoder).await?.checkpoint);
    }
    Ok(())
}

/// The experts, and the kept segments of the dataset. Training does not need the matches of steps.
pub(super) fn sources(snapshot: &SnapshotId, dataset: Option<&DatasetId>) -> Vec<Source> {
    let kept = dataset.map(|dataset| Source::Kept { dataset: dataset.clone(), detail: KeptDetail::Weights });
    std::iter::once(Source::Snapshot(snapshot.clone(), Role::Expert)).chain(kept).collect()
}

pub(super) fn accept(
    job: &Job,
    (encoder, dataset): (Option<&EncoderId>, Option<&DatasetId>),
    checkpoint: BlobId,
    kind: String,
) -> Result<JobResult> {
    Ok(JobResult::Policy(Policy {
        id: result_id(job, PolicyId::try_from)?,
        task_id: job.task_id.clone(),
        kind,
        origin: PolicyOrigin::Trained(Training {
            job_id: job.id.clone(),
            encoder_id: encoder.cloned(),
            dataset_id: dataset.cloned(),
            checkpoint,
        }),
        created_at: Millis::now(),
    }))
}
