//! Export: a dataset in, files out.

use super::{Resolved, result_id};
use crate::{
    domain::{
        dataset::ExportFile,
        id::{DatasetId, ExportId, TaskId},
        job::{Job, JobSpec},
        score::ScoreRun,
        snapshot::Role,
        work::Inputs,
    },
    error::Result,
    jobs::{Jobs, input_episodes::Source},
    store::finish::JobResult,
};

pub(super) async fn resolve(jobs: &Jobs, task: &TaskId, dataset_id: DatasetId) -> Result<Resolved> {
    let (maker, _, _) = jobs.dataset(task, "spec.export.dataset_id", &dataset_id).await?;
    Ok(Resolved::new(JobSpec::Export { dataset_id }, maker))
}

pub(super) async fn inputs(jobs: &Jobs, dataset: &DatasetId, inputs: &mut Inputs) -> Result<()> {
    let run = run_of(jobs, dataset).await?;
    inputs.segment_length = jobs.0.store.segment_length(run.origin.encoder_id()).await?;
    Ok(())
}

/// The run's experts, and the kept segments with their matches and scores.
pub(super) async fn sources(jobs: &Jobs, dataset: &DatasetId) -> Result<Vec<Source>> {
    let run = run_of(jobs, dataset).await?;
    let kept = Source::Kept { dataset: dataset.clone(), detailed: true };
    Ok(vec![Source::Snapshot(run.snapshot_id, Role::Expert), kept])
}

async fn run_of(jobs: &Jobs, dataset: &DatasetId) -> Result<ScoreRun> {
    let dataset = jobs.0.store.dataset(dataset).await?;
    jobs.0.store.score_run(&dataset.score_run_id).await
}

pub(super) fn accept(job: &Job, dataset: &DatasetId, files: Vec<ExportFile>) -> Result<JobResult> {
    Ok(JobResult::Export(result_id(job, ExportId::try_from)?, dataset.clone(), files))
}
