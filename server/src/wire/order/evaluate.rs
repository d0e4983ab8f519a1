//! Evaluating on the wire.

use gleaner_proto::v1;

use super::settings::{device_from, device_to};
use crate::{
    domain::{
        evaluation::{EPISODES, EvaluateSpec, MAX_STEPS},
        id::PolicyId,
        order::{JobOrder, Subject},
    },
    error::{Error, Result},
    wire::{field, policy},
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
    let v1::EvaluateSpec { subject, simulation, episodes, seeds, max_steps, device } = spec;
    let spec = EvaluateSpec {
        simulation: field::tag(&format!("{at}.simulation"), simulation)?,
        episodes: episodes.unwrap_or(EPISODES),
        seeds: if seeds.is_empty() { vec![0] } else { seeds },
        max_steps: max_steps.unwrap_or(MAX_STEPS),
        device: device_from(at, device)?,
    };
    spec.validate().map_err(|(name, mend)| Error::invalid(&format!("{at}.{name}"), mend))?;
    Ok((subject, spec))
}

pub(super) fn to_proto(spec: EvaluateSpec, subject: Option<Subject>) -> v1::EvaluateSpec {
    let EvaluateSpec { simulation, episodes, seeds, max_steps, device } = spec;
    v1::EvaluateSpec {
        subject: subject.map(|subject| match subject {
            Subject::Policy(id) => v1::evaluate_spec::Subject::PolicyId(id.into()),
            Subject::Deployment(name) => v1::evaluate_spec::Subject::Deployment(name),
        }),
        simulation,
        episodes: Some(episodes),
        seeds,
        max_steps: Some(max_steps),
        device: device_to(device),
    }
}
