//! Export: a dataset in, files out.

use std::collections::BTreeMap;

use super::{Resolved, result_id};
use crate::{
    domain::{
        dataset::{Dataset, ExportFile, ExportSpec},
        id::{DatasetId, ExportId, TaskId},
        job::{Job, JobSpec},
        score::ScoreRun,
        snapshot::Role,
        work::Inputs,
    },
    error::{Error, Result},
    jobs::{Jobs, input_episodes::Source},
    store::{KeptDetail, finish::JobResult},
};

pub(super) async fn resolve(jobs: &Jobs, task: &TaskId, dataset_id: DatasetId, spec: ExportSpec) -> Result<Resolved> {
    let (maker, _, _) = jobs.dataset(task, "spec.export.dataset_id", &dataset_id).await?;
    Ok(Resolved::new(JobSpec::Export { dataset_id, spec }, maker))
}

pub(super) async fn inputs(jobs: &Jobs, dataset: &DatasetId, inputs: &mut Inputs) -> Result<()> {
    let dataset = jobs.0.store.dataset(dataset).await?;
    let run = jobs.0.store.score_run(&dataset.score_run_id).await?;
    inputs.origin = origin(&dataset, &run)?;
    inputs.segment_length = jobs.0.store.segment_length(run.origin.encoder_id()).await?;
    Ok(())
}

/// The run's experts, and the kept segments with their matches and scores, or every imperfect episode.
pub(super) async fn sources(jobs: &Jobs, dataset: &DatasetId, spec: ExportSpec) -> Result<Vec<Source>> {
    let run = run_of(jobs, dataset).await?;
    let detail = if spec.whole { KeptDetail::Whole } else { KeptDetail::Scores };
    let kept = Source::Kept { dataset: dataset.clone(), detail };
    Ok(vec![Source::Snapshot(run.snapshot_id, Role::Expert), kept])
}

/// Where a dataset comes from, for the files' readers.
fn origin(dataset: &Dataset, run: &ScoreRun) -> Result<BTreeMap<String, String>> {
    let selection = serde_json::to_string(&dataset.selection);
    let selection = selection.map_err(|error| Error::internal("writing a selection", error))?;
    let origin = [
        ("dataset", dataset.id.to_string()),
        ("run", dataset.score_run_id.to_string()),
        ("snapshot", run.snapshot_id.to_string()),
        ("selection", selection),
    ];
    Ok(origin.into_iter().map(|(name, value)| (name.to_owned(), value)).collect())
}

async fn run_of(jobs: &Jobs, dataset: &DatasetId) -> Result<ScoreRun> {
    let dataset = jobs.0.store.dataset(dataset).await?;
    jobs.0.store.score_run(&dataset.score_run_id).await
}

pub(super) fn accept(job: &Job, dataset: &DatasetId, files: Vec<ExportFile>) -> Result<JobResult> {
    Ok(JobResult::Export(result_id(job, ExportId::try_from)?, dataset.clone(), files))
}
