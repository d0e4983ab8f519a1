//! Policies that other servers run, on the wire.

use gleaner_proto::v1::{self, remote_input::Value};

use super::field::required;
use crate::{
    error::{Error, Result},
    remote::{InputValue, Protocol, RemoteInput, RemotePolicy},
};

/// Reads the task's name and the policy, which is not yet compared with the task.
///
/// # Errors
/// Invalid names the field.
pub fn register_request(request: v1::RegisterPolicyRequest) -> Result<(String, RemotePolicy)> {
    let v1::RegisterPolicyRequest { task, remote } = request;
    let v1::RemotePolicy {
        protocol,
        address,
        model,
        model_version,
        inputs,
        output,
        chunk_length,
        execute_length,
        sequences,
        answer_within_ms,
        source,
    } = required("remote", remote)?;
    let protocol = match v1::RemoteProtocol::try_from(protocol) {
        Ok(v1::RemoteProtocol::OpenInference) => Protocol::OpenInference,
        Ok(v1::RemoteProtocol::Openpi) => Protocol::Openpi,
        Ok(v1::RemoteProtocol::Unspecified) | Err(_) => {
            return Err(Error::invalid("remote.protocol", "must be OPEN_INFERENCE or OPENPI"));
        }
    };
    let inputs = inputs.into_iter().enumerate().map(|(index, input)| read(&format!("remote.inputs[{index}]"), input));
    let remote = RemotePolicy {
        protocol,
        address,
        model,
        model_version,
        inputs: inputs.collect::<Result<_>>()?,
        output,
        chunk_length,
        execute_length,
        sequences,
        answer_within_ms,
        source,
    };
    Ok((task, remote))
}

fn read(path: &str, input: v1::RemoteInput) -> Result<RemoteInput> {
    let v1::RemoteInput { name, value } = input;
    let chosen = |field: &str, set: bool, value: InputValue| {
        if set {
            Ok(value)
        } else {
            Err(Error::invalid(&format!("{path}.{field}"), "must be true, or another value set"))
        }
    };
    let value = match required(&format!("{path}.value"), value)? {
        Value::Camera(camera) => InputValue::Camera(camera),
        Value::CameraPlanes(camera) => InputValue::CameraPlanes(camera),
        Value::Depth(camera) => InputValue::Depth(camera),
        Value::Proprioception(set) => chosen("proprioception", set, InputValue::Proprioception)?,
        Value::Field(field) => InputValue::Field(field),
        Value::ExecutedAction(set) => chosen("executed_action", set, InputValue::ExecutedAction)?,
        Value::Text(text) => InputValue::Text(text),
    };
    Ok(RemoteInput { name, value })
}

/// A policy as a message.
#[must_use]
pub fn remote_to_proto(remote: RemotePolicy) -> v1::RemotePolicy {
    let RemotePolicy {
        protocol,
        address,
        model,
        model_version,
        inputs,
        output,
        chunk_length,
        execute_length,
        sequences,
        answer_within_ms,
        source,
    } = remote;
    let protocol = match protocol {
        Protocol::OpenInference => v1::RemoteProtocol::OpenInference,
        Protocol::Openpi => v1::RemoteProtocol::Openpi,
    };
    let input = |RemoteInput { name, value }| {
        let value = match value {
            InputValue::Camera(camera) => Value::Camera(camera),
            InputValue::CameraPlanes(camera) => Value::CameraPlanes(camera),
            InputValue::Depth(camera) => Value::Depth(camera),
            InputValue::Proprioception => Value::Proprioception(true),
            InputValue::Field(field) => Value::Field(field),
            InputValue::ExecutedAction => Value::ExecutedAction(true),
            InputValue::Text(text) => Value::Text(text),
        };
        v1::RemoteInput { name, value: Some(value) }
    };
    v1::RemotePolicy {
        protocol: protocol.into(),
        address,
        model,
        model_version,
        inputs: inputs.into_iter().map(input).collect(),
        output,
        chunk_length,
        execute_length,
        sequences,
        answer_within_ms,
        source,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn input(name: &str, value: Value) -> v1::RemoteInput {
        v1::RemoteInput { name: name.into(), value: Some(value) }
    }

    fn message() -> v1::RemotePolicy {
        v1::RemotePolicy {
            protocol: v1::RemoteProtocol::Openpi.into(),
            address: "ws://gpu:8000".into(),
            inputs: vec![
                input("a", Value::Camera("top".into())),
                input("b", Value::CameraPlanes("top".into())),
                input("c", Value::Depth("top".into())),
                input("d", Value::Proprioception(true)),
                input("e", Value::Field("joints".into())),
                input("f", Value::ExecutedAction(true)),
                input("prompt", Value::Text("pick".into())),
            ],
            output: "actions".into(),
            chunk_length: 10,
            execute_length: 5,
            answer_within_ms: 500,
            source: "lab".into(),
            ..Default::default()
        }
    }

    fn read(remote: v1::RemotePolicy) -> Result<RemotePolicy> {
        let request = v1::RegisterPolicyRequest { task: "t".into(), remote: Some(remote) };
        Ok(register_request(request)?.1)
    }

    #[test]
    fn a_policy_survives_the_wire() {
        assert_eq!(remote_to_proto(read(message()).unwrap()), message());
    }

    #[test]
    fn a_wrong_field_of_a_remote_policy_is_named() {
        let none = v1::RegisterPolicyRequest { task: "t".into(), remote: None };
        assert!(register_request(none).unwrap_err().message().starts_with("remote: "));
        for protocol in [0, 9] {
            let error = read(v1::RemotePolicy { protocol, ..message() }).unwrap_err();
            assert!(error.message().starts_with("remote.protocol: "), "{error}");
        }
        for (value, field) in [
            (None, "remote.inputs[0].value: "),
            (Some(Value::Proprioception(false)), "remote.inputs[0].proprioception: "),
            (Some(Value::ExecutedAction(false)), "remote.inputs[0].executed_action: "),
        ] {
            let inputs = vec![v1::RemoteInput { name: "x".into(), value }];
            let error = read(v1::RemotePolicy { inputs, ..message() }).unwrap_err();
            assert!(error.message().starts_with(field), "{error}");
        }
    }
}
