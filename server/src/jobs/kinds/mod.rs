//! The kinds of jobs on the server, one file each: the resolution of an order, the inputs of its worker, and the rows
//! of its result. The lists of kinds are here.

mod evaluate;
mod export;
mod extend;
mod pretrain;
mod score;
#[cfg(test)]
mod tests;
mod train;

pub(super) use self::evaluate::simulated;
use super::{Jobs, input_episodes::Source};
use crate::{
    domain::{
        id::{BlobId, EncoderId, EvaluationId, ExportId, JobId, PolicyId, ScoreRunId, TaskId},
        job::{Job, JobKind, JobSpec},
        order::JobOrder,
        work::{Inputs, Made},
    },
    error::{Error, Result},
    store::{Store, finish::JobResult},
};

/// An order with all choices made.
pub(super) struct Resolved {
    pub(super) spec: JobSpec,
    pub(super) result_id: String,
    /// The job that makes its input, if there is one.
    pub(super) maker: Option<JobId>,
    /// The job to queue before it, which makes an input that it lacks.
    pub(super) first: Option<Box<Resolved>>,
}

impl Resolved {
    fn new(spec: JobSpec, maker: Option<JobId>) -> Self {
        Self { result_id: new_result(spec.kind()), spec, maker, first: None }
    }
}

/// A new id for the result of a job of this kind.
pub(super) fn new_result(kind: JobKind) -> String {
    match kind {
        JobKind::Pretrain => EncoderId::new().into(),
        JobKind::Score => ScoreRunId::new().into(),
        JobKind::Train => PolicyId::new().into(),
        JobKind::Export => ExportId::new().into(),
        JobKind::Evaluate => EvaluationId::new().into(),
    }
}

/// Looks up the objects that an order names, and chooses those it leaves out.
///
/// # Errors
/// NotFound for a missing object; Invalid for one that belongs to another task or does not fit; Precondition.
pub(super) async fn resolve(jobs: &Jobs, task: &TaskId, order: JobOrder) -> Result<Resolved> {
    match order {
        JobOrder::Pretrain { snapshot_id, rule, spec } => pretrain::resolve(jobs, task, snapshot_id, &rule, spec).await,
        JobOrder::Score { encoder_id, snapshot_id, extends, spec } => {
            score::resolve(jobs, task, (encoder_id, snapshot_id), extends, spec).await
        }
        JobOrder::Train { data, spec } => train::resolve(jobs, task, data, spec).await,
        JobOrder::Export { dataset_id, spec } => export::resolve(jobs, task, dataset_id, spec).await,
        JobOrder::Evaluate { subject, spec } => evaluate::resolve(jobs, task, subject, spec).await,
    }
}

/// Adds the inputs of a kind's worker to `inputs`, apart from episodes.
///
/// # Errors
/// When the database cannot be read, or a required input is missing.
pub(super) async fn add_inputs(jobs: &Jobs, spec: &JobSpec, inputs: &mut Inputs) -> Result<()> {
    match spec {
        JobSpec::Pretrain { .. } => Ok(()),
        JobSpec::Score { encoder_id, extends, .. } => score::inputs(jobs, encoder_id, extends.as_ref(), inputs).await,
        JobSpec::Train { encoder_id, .. } => train::inputs(jobs, encoder_id.as_ref(), inputs).await,
        JobSpec::Export { dataset_id, .. } => export::inputs(jobs, dataset_id, inputs).await,
        JobSpec::Evaluate { policy_id, spec: _ } => evaluate::inputs(jobs, policy_id, inputs).await,
    }
}

/// Where the episodes of a kind's worker come from, in the order of its input.
///
/// # Errors
/// When the database cannot be read.
pub(super) async fn sources(jobs: &Jobs, spec: &JobSpec) -> Result<Vec<Source>> {
    match spec {
        JobSpec::Pretrain { snapshot_id, .. } | JobSpec::Score { snapshot_id, .. } => Ok(Source::all(snapshot_id)),
        JobSpec::Train { snapshot_id, dataset_id, .. } => Ok(train::sources(snapshot_id, dataset_id.as_ref())),
        JobSpec::Export { dataset_id, spec } => export::sources(jobs, dataset_id, *spec).await,
        JobSpec::Evaluate { .. } => Ok(Vec::new()),
    }
}

/// The rows of a result, checked against the job's spec.
///
/// # Errors
/// Invalid when the result does not fit the job.
pub(super) async fn accept(store: &Store, job: &Job, made: Made) -> Result<JobResult> {
    match (&job.spec, made) {
        (JobSpec::Pretrain { snapshot_id, .. }, Made::Encoder { checkpoint }) => {
            pretrain::accept(job, snapshot_id, checkpoint)
        }
        (
            JobSpec::Score { encoder_id, snapshot_id, extends, spec },
            Made::Scores { lo, hi, quantiles, expert_ids, episodes },
        ) => {
            let run = score::Finished { encoder_id, snapshot_id, extends: extends.as_ref(), spec, lo, hi, quantiles };
            run.accept(store, job, expert_ids, episodes).await
        }
        (JobSpec::Train { encoder_id, dataset_id, .. }, Made::Policy { checkpoint, kind }) => {
            train::accept(job, (encoder_id.as_ref(), dataset_id.as_ref()), checkpoint, kind)
        }
        (JobSpec::Export { dataset_id, .. }, Made::Files(files)) => export::accept(job, dataset_id, files),
        (JobSpec::Evaluate { policy_id, spec }, Made::Trials(seeds)) => evaluate::accept(job, policy_id, spec, seeds),
        (
            JobSpec::Pretrain { .. }
            | JobSpec::Score { .. }
            | JobSpec::Train { .. }
            | JobSpec::Export { .. }
            | JobSpec::Evaluate { .. },
            _,
        ) => Err(Error::invalid("message", format!("does not fit a job of kind {}", job.spec.kind().as_str()))),
    }
}

/// Every blob that a result names.
pub(super) fn blobs(made: &Made) -> Vec<&BlobId> {
    match made {
        Made::Encoder { checkpoint } | Made::Policy { checkpoint, .. } => vec![checkpoint],
        Made::Scores { .. } | Made::Trials(_) => Vec::new(),
        Made::Files(files) => files.iter().map(|file| &file.blob).collect(),
    }
}

fn result_id<T>(job: &Job, read: impl FnOnce(String) -> std::result::Result<T, String>) -> Result<T> {
    read(job.result_id.clone()).map_err(|problem| Error::internal("reading a job's result id", problem))
}
