//! Requests: the deployment, the sequence, and the tensors as an observation.

use bytes::Bytes;
use gleaner_proto::inference::{
    ModelInferRequest, RepositoryIndexRequest,
    model_infer_request::{InferInputTensor, InferRequestedOutputTensor},
};

use super::{
    ACTION,
    contents::{Input, Values, filled, image, vector},
    parameters, quoted,
    tensors::{Role, Tensors},
};
use crate::{
    domain::{
        id::PolicyId,
        observation::{CameraFrame, Observation},
        sequence::Place,
    },
    error::{Error, Result},
    wire::policy::deployment_name,
};

/// The most tensors: two for each camera of the largest task, and some for the other inputs.
const MOST_INPUTS: usize = 64;

/// An inference request, before its tensors are compared with a task.
#[derive(Debug)]
pub(crate) struct Request {
    pub(crate) deployment: String,
    pub(crate) version: Option<PolicyId>,
    /// Returned in the response.
    pub(crate) id: String,
    pub(crate) place: Option<Place>,
    pub(crate) inputs: Inputs,
}

/// Tensors as received, with their values.
#[derive(Debug)]
pub(crate) struct Inputs(Vec<Input>);

/// A model's name and version: a deployment and, unless empty, the policy it must point at.
pub(crate) fn model(prefix: &str, name: String, version: &str) -> Result<(String, Option<PolicyId>)> {
    let version = if version.is_empty() { None } else { Some(PolicyId::parse(&format!("{prefix}version"), version)?) };
    Ok((deployment_name(&format!("{prefix}name"), name)?, version))
}

pub(crate) fn request(request: ModelInferRequest) -> Result<Request> {
    let ModelInferRequest { model_name, model_version, id, parameters, inputs, outputs, raw_input_contents } = request;
    let (deployment, version) = model("model_", model_name, &model_version)?;
    let place = parameters::place(parameters)?;
    requested(&outputs)?;
    Ok(Request { deployment, version, id, place, inputs: Inputs(beside(inputs, raw_input_contents)?) })
}

/// Checks the name of the repository; there is one, without a name.
pub(crate) fn repository(request: RepositoryIndexRequest) -> Result<()> {
    // Every deployment is ready, so `ready` changes nothing.
    let RepositoryIndexRequest { repository_name, ready: _ } = request;
    if repository_name.is_empty() {
        return Ok(());
    }
    Err(Error::invalid("repository_name", "must be empty: there is one repository, without a name"))
}

/// The observation of the tensors. Its cameras are in the task's order.
///
/// # Errors
/// Invalid, naming the tensor.
pub(crate) fn observation(tensors: &Tensors, inputs: Inputs) -> Result<Observation> {
    let mut found: Vec<Option<Input>> = tensors.inputs.iter().map(|_| None).collect();
    for (index, input) in inputs.0.into_iter().enumerate() {
        let field = format!("inputs[{index}].name");
        let Some(place) = tensors.inputs.iter().position(|tensor| tensor.name == input.name) else {
            let name = quoted(&input.name);
            return Err(Error::invalid(&field, format!("is {name}; the deployment takes {}", tensors.names())));
        };
        if found[place].is_some() {
            return Err(Error::invalid(&field, format!("{} is duplicated; send each tensor once", input.name)));
        }
        found[place] = Some(input);
    }
    let frame = |camera: &String| CameraFrame { camera: camera.clone(), color: None, depth: None };
    let mut observation = Observation {
        stamp_ns: 0,
        cameras: tensors.cameras.iter().map(frame).collect(),
        proprioception: Vec::new(),
        executed_action: Vec::new(),
        deadline: None,
        skipped_steps: 0,
    };
    for (tensor, input) in tensors.inputs.iter().zip(found) {
        let Some(input) = input else {
            if tensor.optional() {
                continue;
            }
            return Err(Error::invalid(
                &tensor.field(),
                format!("is missing; the deployment takes {}", tensors.names()),
            ));
        };
        match tensor.role {
            Role::Color(camera) => observation.cameras[camera].color = Some(image(tensor, input)?),
            Role::Depth(camera) => observation.cameras[camera].depth = Some(image(tensor, input)?),
            Role::Proprioception => observation.proprioception = vector(tensor, input)?,
            Role::ExecutedAction => observation.executed_action = vector(tensor, input)?,
        }
    }
    Ok(observation)
}

/// Tensors with their values, which are either all raw or each in its own contents.
fn beside(inputs: Vec<InferInputTensor>, raw: Vec<Bytes>) -> Result<Vec<Input>> {
    if !raw.is_empty() && raw.len() != inputs.len() {
        let (raw, inputs) = (raw.len(), inputs.len());
        return Err(Error::invalid(
            "raw_input_contents",
            format!("has {raw} entries for {inputs} inputs; send one each"),
        ));
    }
    if inputs.len() > MOST_INPUTS {
        return Err(Error::invalid("inputs", format!("are {}, more than any task has", inputs.len())));
    }
    let mut raw = raw.into_iter();
    inputs.into_iter().map(|input| with_values(input, raw.next())).collect()
}

fn with_values(input: InferInputTensor, raw: Option<Bytes>) -> Result<Input> {
    let InferInputTensor { name, datatype, shape, parameters, contents } = input;
    let field = || format!("inputs.{}", quoted(&name));
    if let Some(parameter) = parameters.keys().min() {
        let parameter = quoted(parameter);
        return Err(Error::invalid(
            &field(),
            format!(
                "has the parameter {parameter}; parameters of tensors and shared memory are not supported: send the values"
            ),
        ));
    }
    let values = match (raw, contents) {
        (Some(_), Some(contents)) if filled(&contents).next().is_some() => {
            return Err(Error::invalid(&field(), "has both contents and raw_input_contents; send one of them"));
        }
        (Some(raw), _) => Values::Raw(raw),
        (None, Some(contents)) => Values::Typed(contents),
        (None, None) => return Err(Error::invalid(&field(), "has no values; send contents or raw_input_contents")),
    };
    Ok(Input { name, datatype, shape, values })
}

/// Checks the requested outputs. There is one output, which is always sent; another is rejected.
fn requested(outputs: &[InferRequestedOutputTensor]) -> Result<()> {
    for (index, InferRequestedOutputTensor { name, parameters }) in outputs.iter().enumerate() {
        if name != ACTION {
            let name = quoted(name);
            return Err(Error::invalid(
                &format!("outputs[{index}].name"),
                format!("is {name}; there is only {ACTION}"),
            ));
        }
        if index > 0 {
            return Err(Error::invalid(
                &format!("outputs[{index}].name"),
                format!("{ACTION} is duplicated; request it once"),
            ));
        }
        if let Some(parameter) = parameters.keys().min() {
            let fix = format!("{} is unknown; omit it", quoted(parameter));
            return Err(Error::invalid(&format!("outputs[{index}].parameters"), fix));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests;
