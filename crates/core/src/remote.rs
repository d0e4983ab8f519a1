//! Policies that other servers run: the protocol, the address, and what of an observation is sent under which name.
//!
//! Plain data with its rules; must not know sockets or messages of a protocol.

mod defaults;

use serde::{Deserialize, Serialize};

use crate::{
    error::{Error, Result},
    tag::tag,
    task_spec::{CameraSpec, TaskSpec},
};

/// The kind of such policies. No training has it.
pub const KIND: &str = "remote";

/// The most inputs: two for each camera of the largest task, and some for the other values.
const INPUTS: usize = 64;
/// The most actions of a chunk.
const CHUNK: u32 = 1024;
/// The most bytes of an address, and of a constant text such as an instruction.
const ADDRESS_BYTES: usize = 512;
const TEXT_BYTES: usize = 1000;
/// The limits of an answer's time in milliseconds, and its default.
const WITHIN_MS: u32 = 60_000;
const DEFAULT_WITHIN_MS: u32 = 10_000;

/// The protocol of a policy's server.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Protocol {
    /// The Open Inference Protocol (KServe v2) by gRPC: Triton, and gleaner itself.
    OpenInference,
    /// openpi's protocol: msgpack over a WebSocket.
    Openpi,
}

impl Protocol {
    /// The word of the protocol.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::OpenInference => "open-inference",
            Self::Openpi => "openpi",
        }
    }
}

/// A policy that another server runs.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RemotePolicy {
    /// The protocol of the server.
    pub protocol: Protocol,
    /// `http://HOST:PORT` or `https://…` for the Open Inference Protocol, `ws://HOST:PORT/PATH` or `wss://…` for openpi.
    pub address: String,
    /// The model's name there; empty for openpi.
    pub model: String,
    /// The model's version there; empty: the server's choice.
    pub model_version: String,
    /// What is sent of each observation.
    pub inputs: Vec<RemoteInput>,
    /// The tensor or key of the answer with the actions.
    pub output: String,
    /// The most actions of an answer.
    pub chunk_length: u32,
    /// Actions executed of an answer before the next is requested; 0: a chunk for every observation, and their mean.
    pub execute_length: u32,
    /// Whether the server keeps the history of each session, by the sequences of the Open Inference Protocol.
    pub sequences: bool,
    /// Milliseconds within which the server has to answer.
    pub answer_within_ms: u32,
    /// Where the policy comes from, for people; may be empty.
    pub source: String,
}

/// One value that is sent of each observation.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RemoteInput {
    /// The tensor or key of the server.
    pub name: String,
    /// The value.
    pub value: InputValue,
}

/// What an input holds.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum InputValue {
    /// The color picture of this camera: bytes of height × width × 3.
    Camera(String),
    /// The same as 3 × height × width.
    CameraPlanes(String),
    /// The depth picture of this camera: 16-bit millimetres of height × width.
    Depth(String),
    /// Every value of the proprioception.
    Proprioception,
    /// One field of it.
    Field(String),
    /// The action executed since the observation before; zeros while it is unknown, as for the first observation of a
    /// session.
    ExecutedAction,
    /// A constant text, such as an instruction.
    Text(String),
}

impl RemotePolicy {
    /// The record with its defaults, checked against its task. Without inputs, every camera and the proprioception are
    /// sent under the names that gleaner's own servers of the protocol use.
    ///
    /// # Errors
    /// Invalid, naming the field from `remote.` on.
    pub fn checked(self, task: &TaskSpec) -> Result<Self> {
        let policy = self.with_defaults(task);
        let field = |name: &str| format!("remote.{name}");
        if policy.address.len() > ADDRESS_BYTES || policy.address.chars().any(|c| !c.is_ascii_graphic()) {
            let fix = format!("must be at most {ADDRESS_BYTES} visible ASCII characters");
            return Err(Error::invalid(&field("address"), fix));
        }
        policy.check_names()?;
        if policy.inputs.len() > INPUTS {
            return Err(Error::invalid(&field("inputs"), format!("must be at most {INPUTS}")));
        }
        for (index, input) in policy.inputs.iter().enumerate() {
            let path = field(&format!("inputs[{index}]"));
            name(&format!("{path}.name"), &input.name)?;
            if policy.inputs[..index].iter().any(|before| before.name == input.name) {
                let fix = format!("{} is duplicated; send each tensor or key once", input.name);
                return Err(Error::invalid(&format!("{path}.name"), fix));
            }
            input.value.check(&path, task)?;
        }
        let (chunk, execute) = (policy.chunk_length, policy.execute_length);
        if !(1..=CHUNK).contains(&chunk) {
            return Err(Error::invalid(&field("chunk_length"), format!("must be at most {CHUNK}")));
        }
        if execute > chunk {
            let fix = format!("is {execute}, must be at most chunk_length, which is {chunk}");
            return Err(Error::invalid(&field("execute_length"), fix));
        }
        if policy.answer_within_ms > WITHIN_MS {
            return Err(Error::invalid(&field("answer_within_ms"), format!("must be at most {WITHIN_MS}")));
        }
        tag(&field("source"), policy.source.clone())?;
        Ok(policy)
    }

    /// Checks the names of model, version and output.
    fn check_names(&self) -> Result<()> {
        match self.protocol {
            Protocol::OpenInference => {
                name("remote.model", &self.model)?;
                tag("remote.model_version", self.model_version.clone())?;
            }
            Protocol::Openpi => {
                for (field, set) in
                    [("model", !self.model.is_empty()), ("model_version", !self.model_version.is_empty())]
                {
                    if set {
                        let fix = "openpi's protocol has none; leave it out, and name a policy by the address's path";
                        return Err(Error::invalid(&format!("remote.{field}"), fix));
                    }
                }
                if self.sequences {
                    let fix =
                        "belong to the Open Inference Protocol; each session has a connection of openpi to itself";
                    return Err(Error::invalid("remote.sequences", fix));
                }
            }
        }
        name("remote.output", &self.output)
    }
}

impl InputValue {
    fn check(&self, path: &str, task: &TaskSpec) -> Result<()> {
        match self {
            Self::Camera(name) => camera(&format!("{path}.camera"), name, task).map(|_| ()),
            Self::CameraPlanes(name) => camera(&format!("{path}.camera_planes"), name, task).map(|_| ()),
            Self::Depth(name) => {
                let field = format!("{path}.depth");
                match camera(&field, name, task)?.depth {
                    true => Ok(()),
                    false => Err(Error::invalid(&field, format!("camera {name} has no depth in this task"))),
                }
            }
            Self::Proprioception | Self::ExecutedAction => Ok(()),
            Self::Field(name) => {
                if task.proprioception.iter().any(|field| field.name == *name) {
                    return Ok(());
                }
                let known: Vec<&str> = task.proprioception.iter().map(|field| field.name.as_str()).collect();
                Err(Error::invalid(
                    &format!("{path}.field"),
                    format!("the proprioception has no field {:?}; it has {}", shown(name), known.join(", ")),
                ))
            }
            Self::Text(text) if text.len() > TEXT_BYTES => {
                Err(Error::invalid(&format!("{path}.text"), format!("must be at most {TEXT_BYTES} bytes")))
            }
            Self::Text(_) => Ok(()),
        }
    }
}

fn camera<'a>(field: &str, name: &str, task: &'a TaskSpec) -> Result<&'a CameraSpec> {
    task.cameras.iter().find(|camera| camera.name == name).ok_or_else(|| {
        let known: Vec<&str> = task.cameras.iter().map(|camera| camera.name.as_str()).collect();
        Error::invalid(field, format!("the task has no camera {:?}; it has {}", shown(name), known.join(", ")))
    })
}

/// The name of a tensor, key or model.
fn name(field: &str, name: &str) -> Result<()> {
    if name.is_empty() {
        return Err(Error::invalid(field, "must not be empty"));
    }
    tag(field, name.to_owned()).map(|_| ())
}

fn shown(text: &str) -> String {
    text.chars().take(64).collect()
}

#[cfg(test)]
mod tests;
