//! Pipelines as linked jobs.

use gleaner_core::ScoreSpec;

use crate::domain::{
    dataset::Dataset,
    id::{DatasetId, EncoderId, EvaluationId, JobId, PolicyId, ScoreRunId, SnapshotId, TaskId},
    job::JobSpec,
    order::{NewJob, PipelineQueueing, Plan, needs_encoder},
    schedule::PipelineSpec,
    time::Millis,
};

/// Attempts of a job whose order has no number of attempts.
pub(super) const MAX_ATTEMPTS: u32 = 3;

/// Pretrain, then score, then a dataset, then train, then evaluate: each linked to the one before it.
pub(super) fn chain(task: &TaskId, pipeline: PipelineSpec, snapshot: &SnapshotId, queueing: PipelineQueueing) -> Plan {
    let PipelineQueueing { priority, engine_options, key: _ } = queueing;
    let mut plan = Plan::default();
    let mut add = |spec: JobSpec, result_id: String| {
        let needs = plan.jobs.last().map(|before: &NewJob| before.id.clone()).into_iter().collect();
        let (id, task_id) = (JobId::new(), task.clone());
        let (max_attempts, engine_options) = (MAX_ATTEMPTS, engine_options.clone());
        let job = NewJob { id, task_id, spec, result_id, priority, max_attempts, engine_options, needs, keyed: None };
        plan.jobs.push(job);
    };
    let (encoder, run) = (EncoderId::new(), ScoreRunId::new());
    let selection = pipeline.selection();
    let device = pipeline.pretrain.run.device;
    add(JobSpec::Pretrain { snapshot_id: snapshot.clone(), spec: pipeline.pretrain }, encoder.clone().into());
    if !pipeline.score {
        return plan;
    }
    let spec = pipeline.scoring.unwrap_or_else(|| ScoreSpec { device, ..ScoreSpec::default() });
    let score = JobSpec::Score { encoder_id: encoder.clone(), snapshot_id: snapshot.clone(), extends: None, spec };
    add(score, run.clone().into());
    let Some(selection) = selection else { return plan };
    let dataset = Dataset {
        id: DatasetId::new(),
        task_id: task.clone(),
        score_run_id: run,
        selection,
        created_at: Millis::now(),
    };
    if let Some(spec) = pipeline.train {
        let policy_id = PolicyId::new();
        let encoder_id = needs_encoder(&spec).then_some(encoder);
        let dataset_id = Some(dataset.id.clone());
        let train = JobSpec::Train { encoder_id, snapshot_id: snapshot.clone(), dataset_id, spec };
        add(train, policy_id.clone().into());
        if let Some(spec) = pipeline.evaluate {
            add(JobSpec::Evaluate { policy_id, spec }, EvaluationId::new().into());
        }
    }
    Plan { datasets: vec![dataset], ..plan }
}
