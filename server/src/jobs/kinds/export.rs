//! Export: a dataset in, files out.

use super::{Resolved, result_id};
use crate::{
    domain::{
        dataset::ExportFile,
        id::{DatasetId, ExportId, TaskId},
        job::{Job, JobSpec},
        work::Inputs,
    },
    error::Result,
    jobs::{Jobs, input_episodes::join},
    store::finish::JobResult,
};

pub(super) async fn resolve(jobs: &Jobs, task: &TaskId, dataset_id: DatasetId) -> Result<Resolved> {
    let (maker, _, _) = jobs.dataset(task, "spec.export.dataset_id", &dataset_id).await?;
    Ok(Resolved::new(JobSpec::Export { dataset_id }, maker))
}

pub(super) async fn inputs(jobs: &Jobs, dataset: &DatasetId, inputs: &mut Inputs) -> Result<()> {
    let store = &jobs.0.store;
    let contents = store.dataset_contents(dataset).await?;
    let (experts, imperfect) = jobs.by_role(&contents.snapshot_id).await?;
    inputs.experts = experts;
    inputs.kept = join(contents.kept, imperfect)?;
    for kept in &mut inputs.kept {
        let scores = store.episode_scores(&contents.run.id, &kept.episode.id).await?;
        (kept.similarities, kept.qualities) = (scores.w, scores.q);
    }
    inputs.segment_length = store.segment_length(contents.run.origin.encoder_id()).await?;
    Ok(())
}

pub(super) fn accept(job: &Job, dataset: &DatasetId, files: Vec<ExportFile>) -> Result<JobResult> {
    Ok(JobResult::Export(result_id(job, ExportId::try_from)?, dataset.clone(), files))
}
