//! Orders on the wire, with defaults for what is left out, and the conversion of complete specs back. One file for each
//! kind of job.

mod evaluate;
mod export;
mod pipeline;
mod pretrain;
mod score;
mod settings;
mod train;

use gleaner_proto::v1;

pub use self::pipeline::{pipeline, pipeline_to_proto};
use super::field;
use crate::{
    error::Result,
    job::JobSpec,
    order::{JobOrder, Subject},
};

/// Reads the order of a job.
///
/// # Errors
/// Invalid names the field, such as `spec.pretrain.optim.steps`, and the remedy.
pub fn order(spec: Option<v1::JobSpec>) -> Result<JobOrder> {
    let v1::JobSpec { spec } = field::required("spec", spec)?;
    match field::required("spec", spec)? {
        v1::job_spec::Spec::Pretrain(spec) => {
            let (snapshot_id, rule, spec) = pretrain::from_proto("spec.pretrain", spec)?;
            Ok(JobOrder::Pretrain { snapshot_id, rule, spec })
        }
        v1::job_spec::Spec::Score(spec) => score::order("spec.score", spec),
        v1::job_spec::Spec::Train(spec) => train::order("spec.train", spec),
        v1::job_spec::Spec::Export(spec) => export::order("spec.export", spec),
        v1::job_spec::Spec::Evaluate(spec) => evaluate::order("spec.evaluate", spec),
    }
}

/// A complete spec.
pub fn spec_to_proto(spec: JobSpec) -> v1::JobSpec {
    let spec = match spec {
        JobSpec::Pretrain { snapshot_id, spec } => {
            v1::job_spec::Spec::Pretrain(pretrain::to_proto(&spec, snapshot_id.into(), None))
        }
        JobSpec::Score { encoder_id, snapshot_id, extends, spec } => v1::job_spec::Spec::Score(v1::ScoreSpec {
            encoder_id: encoder_id.into(),
            snapshot_id: snapshot_id.into(),
            extends: extends.map(String::from).unwrap_or_default(),
            ..score::to_proto(&spec)
        }),
        JobSpec::Train { encoder_id, snapshot_id, dataset_id, spec } => {
            let data = match (dataset_id, encoder_id) {
                (Some(dataset), _) => v1::train_spec::Data::DatasetId(dataset.into()),
                (None, Some(encoder)) => v1::train_spec::Data::ExpertsOf(encoder.into()),
                (None, None) => v1::train_spec::Data::ExpertsIn(snapshot_id.into()),
            };
            v1::job_spec::Spec::Train(train::to_proto(&spec, Some(data)))
        }
        JobSpec::Export { dataset_id, spec } => v1::job_spec::Spec::Export(export::to_proto(spec, dataset_id.into())),
        JobSpec::Evaluate { policy_id, spec } => {
            v1::job_spec::Spec::Evaluate(evaluate::to_proto(&spec, Some(Subject::Policy(policy_id))))
        }
    };
    v1::JobSpec { spec: Some(spec) }
}

#[cfg(test)]
mod tests;
