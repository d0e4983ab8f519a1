//! `register-policy`: a policy that another server runs.

use std::str::FromStr;

use clap::{Args, ValueEnum};
use gleaner_proto::v1::{
    Policy, RegisterPolicyRequest, RemoteInput, RemotePolicy, RemoteProtocol, remote_input::Value,
};

use crate::context::Context;
use crate::failure::{Result, present};
use crate::json;
use crate::table::facts;

/// The protocol of a policy's server.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum Protocol {
    /// The Open Inference Protocol (KServe v2) by gRPC: Triton, or another gleaner server.
    OpenInference,
    /// openpi's msgpack over a WebSocket.
    Openpi,
}

#[derive(Args, Debug)]
pub(crate) struct RegisterPolicyArgs {
    /// Name or id of the task. Default: the only task of the server.
    #[arg(long)]
    task: Option<String>,
    /// Protocol of the policy's server.
    #[arg(long)]
    protocol: Protocol,
    /// Address of that server: http://HOST:PORT or https://HOST:PORT for open-inference, ws://HOST:PORT/PATH or wss://…
    /// for openpi. gleaner-server must allow the host (--policy-servers).
    #[arg(long, value_name = "URL")]
    address: String,
    /// Name of the model on that server; for open-inference.
    #[arg(long, default_value = "", hide_default_value = true)]
    model: String,
    /// Version of the model. Default: the server's choice.
    #[arg(long, default_value = "", hide_default_value = true)]
    model_version: String,
    /// Value sent of each observation; can be repeated. NAME is the tensor, or the key (`->` for nested maps); VALUE is
    /// camera:C, planes:C (3 × height × width), depth:C, proprioception, field:F, executed-action or text:TEXT. Default:
    /// every camera and the proprioception, under the names that gleaner's own servers use.
    #[arg(long = "input", value_name = "NAME=VALUE")]
    inputs: Vec<Input>,
    /// Tensor or key of the actions. Default: action, for openpi actions.
    #[arg(long, default_value = "", hide_default_value = true)]
    output: String,
    /// Most actions of an answer, 1 to 1024.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1024))]
    chunk_length: u32,
    /// Actions executed of an answer before the next is requested. 0: request one for every observation and execute the
    /// mean of all predictions for a step.
    #[arg(long, default_value_t = 1)]
    execute_length: u32,
    /// The server keeps the history of each session, as a sequence of the Open Inference Protocol.
    #[arg(long)]
    sequences: bool,
    /// Limit on the time of an answer in milliseconds, up to 60000. Observations of a session wait for no longer.
    #[arg(long, value_name = "MS", default_value_t = 10_000, value_parser = clap::value_parser!(u32).range(1..=60_000))]
    answer_within_ms: u32,
    /// Where the policy comes from, shown with it.
    #[arg(long, default_value = "", hide_default_value = true)]
    source: String,
}

impl RegisterPolicyArgs {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let client = context.client().await?;
        let protocol = match self.protocol {
            Protocol::OpenInference => RemoteProtocol::OpenInference,
            Protocol::Openpi => RemoteProtocol::Openpi,
        };
        let remote = RemotePolicy {
            protocol: protocol.into(),
            address: self.address,
            model: self.model,
            model_version: self.model_version,
            inputs: self.inputs.into_iter().map(|input| input.0).collect(),
            output: self.output,
            chunk_length: self.chunk_length,
            execute_length: self.execute_length,
            sequences: self.sequences,
            answer_within_ms: self.answer_within_ms,
            source: self.source,
        };
        let request =
            RegisterPolicyRequest { task: context.task(&client, self.task.as_deref()).await?, remote: Some(remote) };
        let reply = client.policies().register_policy(request).await?.into_inner();
        let policy = present(reply.policy.as_ref(), "a policy")?;
        context.output.result(|| json::value(&reply), || described(policy))?;
        context.output.next(format_args!("gleaner deploy NAME --policy {}", policy.id));
        Ok(())
    }
}

fn described(policy: &Policy) -> String {
    let remote = policy.remote.clone().unwrap_or_default();
    let inputs: Vec<String> = remote.inputs.into_iter().map(|input| Input(input).to_string()).collect();
    facts([
        ("policy", policy.id.clone()),
        ("address", remote.address),
        ("inputs", inputs.join(", ")),
        ("output", remote.output),
    ])
}

/// One value sent of each observation.
#[derive(Clone, Debug, PartialEq)]
struct Input(RemoteInput);

impl FromStr for Input {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let wrong = || {
            format!(
                "{text:?}: expected NAME=VALUE, where VALUE is camera:C, planes:C, depth:C, proprioception, field:F, \
                 executed-action or text:TEXT"
            )
        };
        let (name, value) = text.split_once('=').ok_or_else(wrong)?;
        let value = match value.split_once(':') {
            Some(("camera", camera)) => Value::Camera(camera.to_owned()),
            Some(("planes", camera)) => Value::CameraPlanes(camera.to_owned()),
            Some(("depth", camera)) => Value::Depth(camera.to_owned()),
            Some(("field", field)) => Value::Field(field.to_owned()),
            Some(("text", text)) => Value::Text(text.to_owned()),
            None if value == "proprioception" => Value::Proprioception(true),
            None if value == "executed-action" => Value::ExecutedAction(true),
            Some(_) | None => return Err(wrong()),
        };
        Ok(Self(RemoteInput { name: name.to_owned(), value: Some(value) }))
    }
}

impl std::fmt::Display for Input {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let RemoteInput { name, value } = &self.0;
        match value {
            Some(Value::Camera(camera)) => write!(f, "{name}=camera:{camera}"),
            Some(Value::CameraPlanes(camera)) => write!(f, "{name}=planes:{camera}"),
            Some(Value::Depth(camera)) => write!(f, "{name}=depth:{camera}"),
            Some(Value::Proprioception(_)) => write!(f, "{name}=proprioception"),
            Some(Value::Field(field)) => write!(f, "{name}=field:{field}"),
            Some(Value::ExecutedAction(_)) => write!(f, "{name}=executed-action"),
            Some(Value::Text(text)) => write!(f, "{name}=text:{text}"),
            None => write!(f, "{name}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inputs_are_parsed_and_shown_alike() {
        for text in [
            "observation/image=camera:top",
            "images->cam_high=planes:top",
            "d=depth:top",
            "state=proprioception",
            "gripper=field:gripper",
            "last=executed-action",
            "prompt=text:pick up: the = cube",
        ] {
            assert_eq!(text.parse::<Input>().unwrap().to_string(), text);
        }
        for text in ["", "x", "x=", "x=camera", "x=picture:top", "x=proprioception:all"] {
            assert!(text.parse::<Input>().unwrap_err().contains("NAME=VALUE"), "{text}");
        }
    }
}
