//! Policies, deployments and observations on the wire.

use std::time::Duration;

use gleaner_proto::v1;

use super::{field, page, remote::remote_to_proto};
use crate::{
    error::{Error, Result},
    id::{PolicyId, ScoreRunId},
    observation::{Acted, CameraFrame, Image, ImageFormat, Observation, Timings},
    page::Page,
    policy::{Assignment, Deployment, DeploymentChange, Policy, PolicyOrigin, Training},
};

const NAME_BYTES: usize = 128;

/// A deployment's name, which may become part of a path or an address elsewhere.
pub fn deployment_name(field: &str, name: String) -> Result<String> {
    let fits = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '_' | '-' | '@');
    if name.is_empty() || name.len() > NAME_BYTES || !name.chars().all(fits) {
        return Err(Error::invalid(
            field,
            format!("must be 1 to {NAME_BYTES} of the characters A-Z a-z 0-9 . _ - @, such as pick_cube@prod"),
        ));
    }
    Ok(name)
}

/// The task's name or id, and the page of its policies.
///
/// # Errors
/// Invalid names the field.
pub fn list_request(request: v1::ListPoliciesRequest) -> Result<(String, Page<PolicyId>)> {
    let v1::ListPoliciesRequest { task, page_size, page_token } = request;
    Ok((task, page::page_by_id(page_size, &page_token)?))
}

/// The first part of a token of a page of deployments, whose second is a name. Without it an id of any kind would be one.
const DEPLOYMENT: &str = "deployment";

/// The task's name or id, or an empty text for every task, and the page of its deployments.
///
/// # Errors
/// Invalid names the field.
pub fn deployments_request(request: v1::ListDeploymentsRequest) -> Result<(String, Page<String>)> {
    let v1::ListDeploymentsRequest { task, page_size, page_token } = request;
    let name = |token: &str| deployment_name("page_token", page::named_key(DEPLOYMENT, token)?.to_owned()).ok();
    Ok((task, page::page(page_size, &page_token, name)?))
}

/// The token of the page of deployments that follow a name; empty behind the last page.
pub fn deployments_token(next: Option<String>) -> String {
    page::token(next.map(|name| page::named_token(DEPLOYMENT, name)))
}

/// Reads the deployment's name and what it points at.
///
/// # Errors
/// Invalid names the field.
pub fn deploy_request(request: v1::DeployRequest) -> Result<(String, Assignment)> {
    let v1::DeployRequest { name, policy_id, score_run_id, hide_history } = request;
    let score_run_id =
        (!score_run_id.is_empty()).then(|| ScoreRunId::parse("score_run_id", &score_run_id)).transpose()?;
    let name = deployment_name("name", name)?;
    Ok((name, Assignment { policy_id: PolicyId::parse("policy_id", &policy_id)?, score_run_id, hide_history }))
}

/// Reads the name of the deployment to roll back.
///
/// # Errors
/// Invalid names the field.
pub fn roll_back_request(request: v1::RollBackRequest) -> Result<String> {
    deployment_name("name", request.name)
}

/// Reads the name of the deployment to delete.
///
/// # Errors
/// Invalid names the field.
pub fn delete_request(request: v1::DeleteDeploymentRequest) -> Result<String> {
    deployment_name("name", request.name)
}

/// Reads the deployment and the observations to act on.
///
/// # Errors
/// Invalid names the field.
pub fn act_request(request: v1::ActRequest) -> Result<(String, Vec<Observation>)> {
    let v1::ActRequest { deployment, observations } = request;
    let deployment = deployment_name("deployment", deployment)?;
    let read = |(index, sent)| observation(&format!("observations[{index}]"), sent);
    Ok((deployment, observations.into_iter().enumerate().map(read).collect::<Result<_>>()?))
}

/// A deadline in microseconds; 0 means none.
pub fn deadline(micros: u32) -> Option<Duration> {
    (micros > 0).then(|| Duration::from_micros(micros.into()))
}

/// Reads one observation at `path` of the request.
///
/// # Errors
/// Invalid names the field.
pub fn observation(path: &str, sent: v1::Observation) -> Result<Observation> {
    let v1::Observation { stamp_ns, cameras, proprioception, executed_action, deadline_us, skipped_steps } = sent;
    let read = |(index, frame)| camera_frame(&format!("{path}.cameras[{index}]"), frame);
    Ok(Observation {
        stamp_ns,
        cameras: cameras.into_iter().enumerate().map(read).collect::<Result<_>>()?,
        proprioception,
        executed_action,
        deadline: deadline(deadline_us),
        skipped_steps,
    })
}

fn camera_frame(path: &str, sent: v1::CameraFrame) -> Result<CameraFrame> {
    let v1::CameraFrame { camera, color, depth } = sent;
    let read =
        |name: &str, sent: Option<v1::Image>| sent.map(|sent| image(&format!("{path}.{name}"), sent)).transpose();
    Ok(CameraFrame { camera, color: read("color", color)?, depth: read("depth", depth)? })
}

fn image(path: &str, sent: v1::Image) -> Result<Image> {
    let v1::Image { format, data } = sent;
    let format = match v1::ImageFormat::try_from(format) {
        Ok(v1::ImageFormat::Unspecified) => ImageFormat::Any,
        Ok(v1::ImageFormat::Jpeg) => ImageFormat::Jpeg,
        Ok(v1::ImageFormat::Png) => ImageFormat::Png,
        Ok(v1::ImageFormat::Raw) => ImageFormat::Raw,
        Err(_) => {
            return Err(Error::invalid(
                &format!("{path}.format"),
                format!("{format} is unknown; use JPEG, PNG or RAW"),
            ));
        }
    };
    Ok(Image { format, data })
}

/// A policy.
pub fn policy(policy: Policy) -> v1::Policy {
    let Policy { id, task_id, kind, origin, created_at } = policy;
    let policy = v1::Policy {
        id: id.into(),
        task_id: task_id.into(),
        kind,
        create_time: Some(field::timestamp(created_at)),
        ..v1::Policy::default()
    };
    match origin {
        PolicyOrigin::Trained(Training { job_id, encoder_id, dataset_id, checkpoint: _ }) => v1::Policy {
            encoder_id: encoder_id.map(Into::into).unwrap_or_default(),
            dataset_id: dataset_id.map(Into::into).unwrap_or_default(),
            job_id: job_id.into(),
            ..policy
        },
        PolicyOrigin::Remote(remote) => v1::Policy { remote: Some(remote_to_proto(*remote)), ..policy },
    }
}

/// A deployment with its history.
pub fn deployment(deployment: Deployment) -> v1::Deployment {
    let policy_id = deployment.policy_id().map(ToString::to_string).unwrap_or_default();
    let score_run_id = deployment.score_run_id().map(ToString::to_string).unwrap_or_default();
    let hide_history = deployment.assignment().is_some_and(|now| now.hide_history);
    let Deployment { name, task_id, history } = deployment;
    let change = |change| {
        let DeploymentChange { assignment: Assignment { policy_id, score_run_id, hide_history }, since } = change;
        v1::DeploymentChange {
            policy_id: policy_id.into(),
            deploy_time: Some(field::timestamp(since)),
            score_run_id: score_run_id.map(Into::into).unwrap_or_default(),
            hide_history,
        }
    };
    let history = history.into_iter().map(change).collect();
    v1::Deployment { name, task_id: task_id.into(), policy_id, history, score_run_id, hide_history }
}

/// The actions of a policy, with the time they took.
pub fn act_response(acted: Acted) -> v1::ActResponse {
    let Acted { stamp_ns, actions, policy_id, timings: spent } = acted;
    v1::ActResponse {
        observation_stamp_ns: stamp_ns,
        actions: action_steps(actions),
        policy_id: policy_id.into(),
        timings: Some(timings(spent)),
    }
}

/// Actions, one list of values for each step.
pub fn action_steps(actions: Vec<Vec<f32>>) -> Vec<v1::ActionStep> {
    actions.into_iter().map(|values| v1::ActionStep { values }).collect()
}

/// Time spent in each stage of a response.
pub fn timings(spent: Timings) -> v1::Timings {
    let Timings { decode_us, queue_us, batch_us, model_us, total_us, batch_size } = spent;
    v1::Timings { decode_us, queue_us, batch_us, model_us, total_us, batch_size }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_outside_the_character_set_are_rejected() {
        assert_eq!(deployment_name("name", "pick_cube@prod".into()).unwrap(), "pick_cube@prod");
        for bad in ["", "a b", "../x", "ö", &"x".repeat(129)] {
            assert!(deployment_name("name", bad.into()).unwrap_err().message().starts_with("name: "), "{bad}");
        }
    }

    #[test]
    fn an_unknown_image_format_is_named_by_its_path() {
        let color = Some(v1::Image { format: 9, data: Default::default() });
        let frame = v1::CameraFrame { camera: "top".into(), color, depth: None };
        let observations = vec![v1::Observation { cameras: vec![frame], ..Default::default() }];
        let error = act_request(v1::ActRequest { deployment: "d".into(), observations }).unwrap_err();
        assert!(error.message().starts_with("observations[0].cameras[0].color.format: "), "{error}");
    }
}
