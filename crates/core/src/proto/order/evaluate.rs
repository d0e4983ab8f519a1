//! Evaluating on the wire.

use crate::EvaluateSpec;
use gleaner_proto::v1;

use super::settings;
use crate::{
    error::{Error, Result},
    id::PolicyId,
    order::{JobOrder, Subject},
    proto::policy,
};

pub(super) fn order(at: &str, spec: v1::EvaluateSpec) -> Result<JobOrder> {
    let (subject, spec) = from_proto(at, spec)?;
    let subject = match subject {
        Some(v1::evaluate_spec::Subject::PolicyId(id)) => {
            Subject::Policy(PolicyId::parse(&format!("{at}.policy_id"), &id)?)
        }
        Some(v1::evaluate_spec::Subject::Deployment(name)) => {
            Subject::Deployment(policy::deployment_name(&format!("{at}.deployment"), name)?)
        }
        None => return Err(Error::invalid(&format!("{at}.subject"), "must be set: a policy_id, or a deployment")),
    };
    Ok(JobOrder::Evaluate { subject, spec })
}

pub(super) fn from_proto(
    at: &str,
    spec: v1::EvaluateSpec,
) -> Result<(Option<v1::evaluate_spec::Subject>, EvaluateSpec)> {
    let v1::EvaluateSpec { subject, settings } = spec;
    Ok((subject, settings::from_proto(at, settings, EvaluateSpec::from_values)?))
}

pub(super) fn to_proto(spec: &EvaluateSpec, subject: Option<Subject>) -> v1::EvaluateSpec {
    let subject = subject.map(|subject| match subject {
        Subject::Policy(id) => v1::evaluate_spec::Subject::PolicyId(id.into()),
        Subject::Deployment(name) => v1::evaluate_spec::Subject::Deployment(name),
    });
    v1::EvaluateSpec { subject, settings: settings::to_proto(&spec.values()) }
}
