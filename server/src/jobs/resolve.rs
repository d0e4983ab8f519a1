//! Orders resolved: what they name is looked up, and what they leave out is chosen.

use gleaner_core::EvaluateSpec;

use super::Jobs;
use crate::{
    domain::{
        id::{DatasetId, EncoderId, EvaluationId, ExportId, JobId, PolicyId, ScoreRunId, SnapshotId, TaskId},
        job::{Job, JobSpec},
        order::{JobOrder, Subject, TrainData, needs_encoder},
        snapshot::RoleRule,
    },
    error::{Error, Result},
};

/// An order with everything chosen.
pub(super) struct Resolved {
    pub(super) spec: JobSpec,
    pub(super) result_id: String,
    /// The job that makes its input, if a job does.
    pub(super) maker: Option<JobId>,
}

impl Jobs {
    pub(super) async fn resolve(&self, task: &TaskId, order: JobOrder) -> Result<Resolved> {
        match order {
            JobOrder::Pretrain { snapshot_id, rule, spec } => {
                let snapshot_id = self.snapshot(task, "spec.pretrain.snapshot_id", snapshot_id, &rule).await?;
                let spec = JobSpec::Pretrain { snapshot_id, spec };
                Ok(Resolved { spec, result_id: EncoderId::new().into(), maker: None })
            }
            JobOrder::Score { encoder_id, snapshot_id, extends: Some(run), spec } => {
                let spec = self.extension(task, &run, (encoder_id, snapshot_id), spec).await?;
                let maker = self.0.store.score_run(&run).await?.job_id;
                Ok(Resolved { spec, result_id: ScoreRunId::new().into(), maker: Some(maker) })
            }
            JobOrder::Score { encoder_id, snapshot_id, extends: None, spec } => {
                let field = "spec.score.encoder_id";
                let encoder_id = encoder_id.ok_or_else(|| Error::invalid(field, "must be set"))?;
                let (maker, own) = self.encoder(task, field, &encoder_id).await?;
                let snapshot_id = self.scored(task, snapshot_id, own).await?;
                let spec = JobSpec::Score { encoder_id, snapshot_id, extends: None, spec };
                Ok(Resolved { spec, result_id: ScoreRunId::new().into(), maker: Some(maker) })
            }
            JobOrder::Train { data, spec } => {
                let scratch = !needs_encoder(&spec);
                let (maker, encoder_id, snapshot_id, dataset_id) = self.learned_from(task, data, scratch).await?;
                let spec = JobSpec::Train { encoder_id, snapshot_id, dataset_id, spec };
                Ok(Resolved { spec, result_id: PolicyId::new().into(), maker })
            }
            JobOrder::Export { dataset_id } => {
                let (maker, _, _) = self.dataset(task, "spec.export.dataset_id", &dataset_id).await?;
                let spec = JobSpec::Export { dataset_id };
                Ok(Resolved { spec, result_id: ExportId::new().into(), maker: Some(maker) })
            }
            JobOrder::Evaluate { subject, spec } => {
                let spec = self.simulated(task, "spec.evaluate.settings.simulation", spec).await?;
                let (maker, policy_id) = self.subject(task, subject).await?;
                let spec = JobSpec::Evaluate { policy_id, spec };
                Ok(Resolved { spec, result_id: EvaluationId::new().into(), maker: Some(maker) })
            }
        }
    }

    /// The snapshot that a scoring was told, or the encoder's own.
    pub(super) async fn scored(&self, task: &TaskId, told: Option<SnapshotId>, own: SnapshotId) -> Result<SnapshotId> {
        match told {
            Some(id) => self.snapshot(task, "spec.score.snapshot_id", Some(id), &RoleRule::default()).await,
            None => Ok(own),
        }
    }

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
        let (snapshot, _) = self.0.store.snapshot(&id).await?;
        same_task(field, id.as_str(), &snapshot.task_id, task)?;
        self.0.store.expect_recordings(&id).await?;
        Ok(id)
    }

    /// The job that makes an encoder, and the snapshot that it sees.
    pub(super) async fn encoder(&self, task: &TaskId, field: &str, id: &EncoderId) -> Result<(JobId, SnapshotId)> {
        match self.0.store.job_of_result(id.as_str()).await? {
            Some(Job { id: maker, task_id, spec: JobSpec::Pretrain { snapshot_id, .. }, .. }) => {
                same_task(field, id.as_str(), &task_id, task)?;
                self.0.store.expect_recordings(&snapshot_id).await?;
                Ok((maker, snapshot_id))
            }
            Some(_) | None => Err(Error::not_found("encoder", id)),
        }
    }

    /// The job that makes a dataset's scores, and the encoder and snapshot that it works with.
    async fn dataset(&self, task: &TaskId, field: &str, id: &DatasetId) -> Result<(JobId, EncoderId, SnapshotId)> {
        let dataset = self.0.store.dataset(id).await?;
        same_task(field, id.as_str(), &dataset.task_id, task)?;
        match self.0.store.job_of_result(dataset.score_run_id.as_str()).await? {
            Some(Job { id: maker, spec: JobSpec::Score { encoder_id, snapshot_id, .. }, .. }) => {
                self.0.store.expect_recordings(&snapshot_id).await?;
                Ok((maker, encoder_id, snapshot_id))
            }
            Some(_) | None => Err(Error::not_found("score run", &dataset.score_run_id)),
        }
    }

    /// What a training learns from: the job to wait for, the encoder to begin from, the experts' snapshot, the dataset.
    /// A policy from scratch begins from no encoder, and with experts alone waits for none.
    async fn learned_from(
        &self,
        task: &TaskId,
        data: TrainData,
        scratch: bool,
    ) -> Result<(Option<JobId>, Option<EncoderId>, SnapshotId, Option<DatasetId>)> {
        match data {
            TrainData::ExpertsOf(encoder) => {
                let (maker, snapshot) = self.encoder(task, "spec.train.experts_of", &encoder).await?;
                Ok(if scratch { (None, None, snapshot, None) } else { (Some(maker), Some(encoder), snapshot, None) })
            }
            TrainData::ExpertsIn(id) => {
                let snapshot = self.snapshot(task, "spec.train.experts_in", Some(id), &RoleRule::default()).await?;
                Ok((None, None, snapshot, None))
            }
            TrainData::Dataset(dataset) => {
                let (maker, encoder, snapshot) = self.dataset(task, "spec.train.dataset_id", &dataset).await?;
                Ok((Some(maker), (!scratch).then_some(encoder), snapshot, Some(dataset)))
            }
        }
    }

    /// The policy to evaluate, and the job that makes it.
    async fn subject(&self, task: &TaskId, subject: Subject) -> Result<(JobId, PolicyId)> {
        let (field, id) = match subject {
            Subject::Policy(id) => ("spec.evaluate.policy_id", id),
            Subject::Deployment(name) => {
                let deployment = self.0.store.deployment(&name).await?;
                let id = deployment.policy_id().cloned().ok_or_else(|| Error::not_found("deployment", name))?;
                ("spec.evaluate.deployment", id)
            }
        };
        match self.0.store.job_of_result(id.as_str()).await? {
            Some(Job { id: maker, task_id, spec: JobSpec::Train { .. }, .. }) => {
                same_task(field, id.as_str(), &task_id, task)?;
                Ok((maker, id))
            }
            Some(_) | None => Err(Error::not_found("policy", id)),
        }
    }

    /// Trials in the simulator's task of that name, or of the task's own: refused now if it cannot be simulated.
    pub(super) async fn simulated(&self, task: &TaskId, field: &str, spec: EvaluateSpec) -> Result<EvaluateSpec> {
        let task = self.0.store.task_by_id(task).await?;
        let simulation = gleaner_sim::simulated(&task.spec, &spec.simulation)
            .map_err(|problem| Error::invalid(field, problem))?
            .0
            .name()
            .to_owned();
        Ok(EvaluateSpec { simulation, ..spec })
    }
}

pub(super) fn same_task(field: &str, id: &str, found: &TaskId, task: &TaskId) -> Result<()> {
    if found == task {
        return Ok(());
    }
    Err(Error::invalid(field, format!("{id} belongs to {found}, not to {task}; name one of this task")))
}

#[cfg(test)]
mod tests;
