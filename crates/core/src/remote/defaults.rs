//! What a record leaves out: the names that gleaner's own servers of each protocol use.

use super::{DEFAULT_WITHIN_MS, InputValue, Protocol, RemoteInput, RemotePolicy};
use crate::task_spec::{CameraSpec, TaskSpec};

impl RemotePolicy {
    pub(super) fn with_defaults(mut self, task: &TaskSpec) -> Self {
        if self.output.is_empty() {
            let output = match self.protocol {
                Protocol::OpenInference => "action",
                Protocol::Openpi => "actions",
            };
            output.clone_into(&mut self.output);
        }
        if self.inputs.is_empty() {
            self.inputs = inputs(self.protocol, task);
        }
        if self.chunk_length == 0 {
            self.chunk_length = 1;
        }
        if self.answer_within_ms == 0 {
            self.answer_within_ms = DEFAULT_WITHIN_MS;
        }
        self
    }
}

fn inputs(protocol: Protocol, task: &TaskSpec) -> Vec<RemoteInput> {
    let camera = |camera: &CameraSpec| {
        let name = camera.name.clone();
        let (color, depth) = match protocol {
            Protocol::OpenInference => (name.clone(), format!("{name}.depth")),
            Protocol::Openpi => (format!("observation/{name}"), format!("observation/{name}_depth")),
        };
        let color = RemoteInput { name: color, value: InputValue::Camera(name.clone()) };
        let depth = camera.depth.then_some(RemoteInput { name: depth, value: InputValue::Depth(name) });
        std::iter::once(color).chain(depth).collect::<Vec<_>>()
    };
    let mut inputs: Vec<RemoteInput> = task.cameras.iter().flat_map(camera).collect();
    let (state, executed) = match protocol {
        Protocol::OpenInference => ("proprioception", Some("executed_action")),
        Protocol::Openpi => ("observation/state", None),
    };
    inputs.push(RemoteInput { name: state.to_owned(), value: InputValue::Proprioception });
    inputs.extend(executed.map(|name| RemoteInput { name: name.to_owned(), value: InputValue::ExecutedAction }));
    inputs
}
