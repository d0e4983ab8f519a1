//! Evaluation: a policy in, the outcomes of its trials in the embedded simulator out.

use gleaner_core::EvaluateSpec;

use super::{Resolved, result_id};
use crate::{
    domain::{
        evaluation::{Evaluation, SeedResult},
        id::{EncoderId, EvaluationId, JobId, PolicyId, TaskId},
        job::{Job, JobSpec},
        order::Subject,
        policy::no_history,
        time::Millis,
        work::Inputs,
    },
    error::{Error, Result},
    jobs::{Jobs, lookup::same_task},
    store::finish::JobResult,
};

pub(super) async fn resolve(jobs: &Jobs, task: &TaskId, subject: Subject, spec: EvaluateSpec) -> Result<Resolved> {
    let spec = simulated(jobs, task, "spec.evaluate.settings.simulation", spec).await?;
    let Evaluated { maker, policy_id, hidden, steps } = policy(jobs, task, subject).await?;
    // Earlier versions stored deployments that hide a history which their policy does not have.
    if spec.hide_history && steps == 0 {
        return Err(no_history("spec.evaluate.settings.hide_history", &policy_id));
    }
    let spec = EvaluateSpec { hide_history: spec.hide_history || hidden, ..spec };
    Ok(Resolved::new(JobSpec::Evaluate { policy_id, spec }, Some(maker)))
}

/// A policy to evaluate.
struct Evaluated {
    /// The job that makes it.
    maker: JobId,
    policy_id: PolicyId,
    /// Whether its deployment hides the history.
    hidden: bool,
    /// The steps before the newest one that it sees.
    steps: u64,
}

async fn policy(jobs: &Jobs, task: &TaskId, subject: Subject) -> Result<Evaluated> {
    let (field, id, hidden) = match subject {
        Subject::Policy(id) => ("spec.evaluate.policy_id", id, false),
        Subject::Deployment(name) => {
            let deployment = jobs.0.store.deployment(&name).await?;
            let now = deployment.assignment().ok_or_else(|| Error::not_found("deployment", name))?;
            ("spec.evaluate.deployment", now.policy_id.clone(), now.hide_history)
        }
    };
    match jobs.0.store.job_of_result(id.as_str()).await? {
        Some(Job { id: maker, task_id, spec: JobSpec::Train { encoder_id, spec, .. }, .. }) => {
            same_task(field, id.as_str(), &task_id, task)?;
            let steps = match spec.history_steps() {
                Some(steps) => steps,
                None => steps_of(jobs, encoder_id.as_ref()).await?,
            };
            Ok(Evaluated { maker, policy_id: id, hidden, steps })
        }
        Some(_) => Err(Error::not_found("policy", id)),
        None => Err(match jobs.0.store.policy(&id).await {
            Ok(policy) => elsewhere(&policy.id),
            Err(error) => error,
        }),
    }
}

/// The steps before the newest one that a policy sees which begins from an encoder, finished or not.
async fn steps_of(jobs: &Jobs, encoder: Option<&EncoderId>) -> Result<u64> {
    let Some(id) = encoder else { return Ok(0) };
    match jobs.0.store.job_of_result(id.as_str()).await? {
        Some(Job { spec: JobSpec::Pretrain { spec, .. }, .. }) => Ok(spec.model.segment_length.into()),
        Some(_) | None => Err(Error::not_found("encoder", id)),
    }
}

/// What evaluates a deployment in a simulator that is not built in.
const NOT_BUILT_IN: &str = "`python -m gleaner.simulators --report` in one that it lists, or gleaner.evaluate of the Python \
                            client in your own, then `gleaner report-evaluation`";

/// A worker has a policy's checkpoint, and connects to this server alone.
fn elsewhere(policy: &PolicyId) -> Error {
    Error::precondition(format!(
        "{policy} runs on another server, to which jobs do not connect; evaluate its deployment by sessions: \
         `gleaner drive NAME --report` in the built-in simulator, or {NOT_BUILT_IN}"
    ))
}

/// Trials in the simulator's task of that name, or of the task's own: rejected now if it cannot be simulated.
pub(in crate::jobs) async fn simulated(
    jobs: &Jobs,
    task: &TaskId,
    field: &str,
    spec: EvaluateSpec,
) -> Result<EvaluateSpec> {
    let task = jobs.0.store.task_by_id(task).await?;
    let simulation = gleaner_sim::simulated(&task.spec, &spec.simulation)
        .map_err(|problem| {
            Error::invalid(
                field,
                format!("{problem}; in a simulator that is not built in, evaluate a deployment: {NOT_BUILT_IN}"),
            )
        })?
        .0
        .name()
        .to_owned();
    Ok(EvaluateSpec { simulation, ..spec })
}

pub(super) async fn inputs(jobs: &Jobs, policy: &PolicyId, inputs: &mut Inputs) -> Result<()> {
    let policy = jobs.0.store.policy(policy).await?;
    let training = policy.training().ok_or_else(|| elsewhere(&policy.id))?;
    inputs.policy = Some(training.checkpoint.clone());
    Ok(())
}

pub(super) fn accept(job: &Job, policy: &PolicyId, spec: &EvaluateSpec, seeds: Vec<SeedResult>) -> Result<JobResult> {
    let trials = |result: &SeedResult| (result.seed, result.episodes);
    if !seeds.iter().map(trials).eq(spec.seeds.iter().map(|&seed| (seed, spec.episodes))) {
        return Err(Error::invalid("message.evaluation.seeds", "are not the seeds and episodes of the job"));
    }
    Ok(JobResult::Evaluation(Evaluation {
        id: result_id(job, EvaluationId::try_from)?,
        policy_id: policy.clone(),
        job_id: Some(job.id.clone()),
        simulation: spec.simulation.clone(),
        seeds,
        created_at: Millis::now(),
    }))
}

#[cfg(test)]
mod tests;
