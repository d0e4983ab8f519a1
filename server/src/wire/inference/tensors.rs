//! The tensors of a task's shape, by name.

use gleaner_learn::TaskShape;

use crate::error::{Error, Kind, Result};

/// The path of an observation's fields in errors.
pub(crate) const PATH: &str = "inputs";

const PROPRIOCEPTION: &str = "proprioception";
const EXECUTED_ACTION: &str = "executed_action";

/// The content of a tensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Role {
    /// RGB of the task's camera of this number.
    Color(usize),
    /// Its depth, in millimetres.
    Depth(usize),
    Proprioception,
    ExecutedAction,
}

/// The description of one tensor.
#[derive(Debug)]
pub(super) struct Tensor {
    pub(super) name: String,
    pub(super) role: Role,
    /// Without the batch dimension.
    pub(super) shape: Vec<i64>,
}

impl Tensor {
    pub(super) fn datatype(&self) -> &'static str {
        match self.role {
            Role::Color(_) => "UINT8",
            Role::Depth(_) => "UINT16",
            Role::Proprioception | Role::ExecutedAction => "FP32",
        }
    }

    pub(super) fn is_image(&self) -> bool {
        matches!(self.role, Role::Color(_) | Role::Depth(_))
    }

    pub(super) fn optional(&self) -> bool {
        self.role == Role::ExecutedAction
    }

    pub(super) fn field(&self) -> String {
        format!("{PATH}.{}", self.name)
    }
}

/// A task's tensors, in the order of its cameras.
#[derive(Debug)]
pub(crate) struct Tensors {
    pub(super) inputs: Vec<Tensor>,
    pub(super) cameras: Vec<String>,
    /// Values of one action.
    pub(super) action: i64,
}

impl Tensors {
    /// The tensors for a shape.
    ///
    /// # Errors
    /// Precondition when a camera has the name of another tensor.
    pub(crate) fn of(shape: &TaskShape) -> Result<Self> {
        let tensor = |name: String, role, shape| Tensor { name, role, shape };
        let mut inputs = Vec::new();
        for (number, camera) in shape.cameras.iter().enumerate() {
            let (height, width) = camera.sizes().recorded();
            let (height, width) = (i64::from(height), i64::from(width));
            inputs.push(tensor(camera.name.clone(), Role::Color(number), vec![height, width, 3]));
            if camera.depth {
                inputs.push(tensor(format!("{}.depth", camera.name), Role::Depth(number), vec![height, width]));
            }
        }
        let (proprioception, action) = (size(shape.proprioception)?, size(shape.action)?);
        inputs.push(tensor(PROPRIOCEPTION.into(), Role::Proprioception, vec![proprioception]));
        inputs.push(tensor(EXECUTED_ACTION.into(), Role::ExecutedAction, vec![action]));
        for (index, one) in inputs.iter().enumerate() {
            if inputs[..index].iter().any(|before| before.name == one.name) {
                return Err(Error::precondition(format!(
                    "two of this task's tensors would be called {}; use PolicyService, or name its cameras otherwise",
                    one.name
                )));
            }
        }
        Ok(Self { inputs, cameras: shape.cameras.iter().map(|camera| camera.name.clone()).collect(), action })
    }

    /// The same error, with the path of a camera's image replaced by the name of its tensor.
    pub(crate) fn name(&self, error: Error) -> Error {
        if error.kind() != Kind::Invalid {
            return error;
        }
        for (number, camera) in self.cameras.iter().enumerate() {
            for (image, suffix) in [("color", ""), ("depth", ".depth")] {
                let place = format!("{PATH}.cameras[{number}].{image}: ");
                if let Some(fix) = error.message().strip_prefix(&place) {
                    return Error::invalid(&format!("{PATH}.{camera}{suffix}"), fix);
                }
            }
        }
        error
    }

    /// The names, for messages.
    pub(super) fn names(&self) -> String {
        self.inputs.iter().map(|tensor| tensor.name.as_str()).collect::<Vec<_>>().join(", ")
    }
}

fn size(count: usize) -> Result<i64> {
    i64::try_from(count).map_err(|error| Error::internal("reading a task's shape", error))
}
