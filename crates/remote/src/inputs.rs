//! What is sent of a step, under the names of the other server.

use std::{borrow::Cow, ops::Range};

use gleaner_core::{
    Error, Result, TaskSpec,
    remote::{InputValue, RemotePolicy},
};

/// One step of an episode. Pictures are in the task's order: for each camera height × width × 3 bytes, then its depth
/// as little-endian 16-bit millimetres, if it has any.
#[derive(Debug, Clone, Copy)]
pub struct Step<'a> {
    /// The pictures, at the size of a step.
    pub frame: &'a [u8],
    /// In physical units.
    pub proprioception: &'a [f32],
    /// The action executed since the step before; `None` for the first step.
    pub executed: Option<&'a [f32]>,
}

/// A value of a step.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Value<'a> {
    /// Bytes of this shape.
    Bytes([usize; 3], Cow<'a, [u8]>),
    /// Little-endian 16-bit numbers of this shape.
    Words([usize; 2], &'a [u8]),
    /// Numbers.
    Numbers(Cow<'a, [f32]>),
    /// A text.
    Text(&'a str),
}

/// The inputs of a policy, with their places in a step.
#[derive(Debug)]
pub(crate) struct Inputs {
    inputs: Vec<(String, Place)>,
    frame: usize,
    proprioception: usize,
    action: usize,
}

#[derive(Debug)]
enum Place {
    Color { bytes: Range<usize>, height: usize, width: usize, planes: bool },
    Depth { bytes: Range<usize>, height: usize, width: usize },
    Numbers(Range<usize>),
    Executed,
    Text(String),
}

impl Inputs {
    /// The inputs of a checked policy.
    ///
    /// # Errors
    /// Internal when the task lacks what the record names.
    pub(crate) fn of(policy: &RemotePolicy, task: &TaskSpec) -> Result<Self> {
        let inputs = policy.inputs.iter().map(|input| Ok((input.name.clone(), place(&input.value, task)?)));
        let inputs: Vec<_> = inputs.collect::<Result<_>>()?;
        let frame = task.cameras.iter().map(bytes).sum();
        Ok(Self { inputs, frame, proprioception: task.proprioception_size(), action: task.action_size() })
    }

    /// The values of a step, by name.
    ///
    /// # Errors
    /// Internal when the step has another size.
    pub(crate) fn values<'a>(&'a self, step: &Step<'a>) -> Result<Vec<(&'a str, Value<'a>)>> {
        let executed = step.executed.map_or(self.action, <[f32]>::len);
        let found = (step.frame.len(), step.proprioception.len(), executed);
        if found != (self.frame, self.proprioception, self.action) {
            return Err(Error::internal("calling a policy's server", format!("a step has the sizes {found:?}")));
        }
        Ok(self.inputs.iter().map(|(name, place)| (name.as_str(), self.value(place, step))).collect())
    }

    /// A step of zeros.
    pub(crate) fn blank(&self) -> (Vec<u8>, Vec<f32>) {
        (vec![0; self.frame], vec![0.0; self.proprioception])
    }

    fn value<'a>(&self, place: &'a Place, step: &Step<'a>) -> Value<'a> {
        match place {
            Place::Color { bytes, height, width, planes: false } => {
                Value::Bytes([*height, *width, 3], Cow::Borrowed(&step.frame[bytes.clone()]))
            }
            Place::Color { bytes, height, width, planes: true } => {
                Value::Bytes([3, *height, *width], Cow::Owned(planes(&step.frame[bytes.clone()])))
            }
            Place::Depth { bytes, height, width } => Value::Words([*height, *width], &step.frame[bytes.clone()]),
            Place::Numbers(numbers) => Value::Numbers(Cow::Borrowed(&step.proprioception[numbers.clone()])),
            Place::Executed => {
                Value::Numbers(step.executed.map_or_else(|| vec![0.0; self.action].into(), Cow::Borrowed))
            }
            Place::Text(text) => Value::Text(text),
        }
    }
}

fn bytes(camera: &gleaner_core::CameraSpec) -> usize {
    camera.height as usize * camera.width as usize * if camera.depth { 5 } else { 3 }
}

/// Pixel by pixel to channel by channel.
fn planes(pixels: &[u8]) -> Vec<u8> {
    (0..3).flat_map(|channel| pixels.iter().skip(channel).step_by(3).copied()).collect()
}

fn place(value: &InputValue, task: &TaskSpec) -> Result<Place> {
    let camera = |name: &String| {
        let mut begin = 0;
        for camera in &task.cameras {
            if camera.name == *name {
                let pixels = camera.height as usize * camera.width as usize;
                return Ok((begin, pixels, camera.height as usize, camera.width as usize));
            }
            begin += bytes(camera);
        }
        Err(missing(name))
    };
    Ok(match value {
        InputValue::Camera(name) | InputValue::CameraPlanes(name) => {
            let (begin, pixels, height, width) = camera(name)?;
            let planes = matches!(value, InputValue::CameraPlanes(_));
            Place::Color { bytes: begin..begin + 3 * pixels, height, width, planes }
        }
        InputValue::Depth(name) => {
            let (begin, pixels, height, width) = camera(name)?;
            let has = task.cameras.iter().any(|camera| camera.name == *name && camera.depth);
            if !has {
                return Err(missing(name));
            }
            Place::Depth { bytes: begin + 3 * pixels..begin + 5 * pixels, height, width }
        }
        InputValue::Proprioception => Place::Numbers(0..task.proprioception_size()),
        InputValue::Field(name) => {
            let mut begin = 0;
            let found = task.proprioception.iter().find_map(|field| {
                let end = begin + field.size as usize;
                let range = std::mem::replace(&mut begin, end)..end;
                (field.name == *name).then_some(range)
            });
            Place::Numbers(found.ok_or_else(|| missing(name))?)
        }
        InputValue::ExecutedAction => Place::Executed,
        InputValue::Text(text) => Place::Text(text.clone()),
    })
}

fn missing(name: &str) -> Error {
    Error::internal("reading a remote policy", format!("its task has no {name}"))
}

#[cfg(test)]
pub(crate) mod tests {
    use gleaner_core::{
        CameraSpec, FieldSpec,
        remote::{Protocol, RemoteInput},
    };

    use super::*;

    /// Two cameras of 1 × 2, the first with depth; three values of proprioception in two fields; two of an action.
    pub(crate) fn task() -> TaskSpec {
        let camera = |name: &str, depth| CameraSpec { name: name.into(), height: 1, width: 2, depth, recorded: None };
        TaskSpec {
            name: "t".into(),
            instruction: String::new(),
            openpi: Vec::new(),
            rate_hz: 10.0,
            cameras: vec![camera("top", true), camera("wrist", false)],
            proprioception: vec![FieldSpec::new("joints", 2), FieldSpec::new("gripper", 1)],
            action: vec![FieldSpec::new("move", 2)],
            alignment: gleaner_core::Alignment::default(),
            tolerance: 0.25,
            mappings: Vec::new(),
        }
    }

    pub(crate) fn policy(protocol: Protocol, address: &str, inputs: Vec<RemoteInput>) -> RemotePolicy {
        let policy = RemotePolicy {
            protocol,
            address: address.into(),
            model: if protocol == Protocol::OpenInference { "arm".into() } else { String::new() },
            model_version: String::new(),
            inputs,
            output: String::new(),
            chunk_length: 4,
            execute_length: 1,
            sequences: false,
            answer_within_ms: 500,
            source: String::new(),
        };
        policy.checked(&task()).unwrap()
    }

    #[test]
    fn each_value_is_at_its_place_in_the_step() {
        let input = |value| RemoteInput { name: format!("{value:?}"), value };
        let inputs = vec![
            input(InputValue::Camera("wrist".into())),
            input(InputValue::CameraPlanes("top".into())),
            input(InputValue::Depth("top".into())),
            input(InputValue::Proprioception),
            input(InputValue::Field("gripper".into())),
            input(InputValue::ExecutedAction),
            input(InputValue::Text("pick".into())),
        ];
        let inputs = Inputs::of(&policy(Protocol::OpenInference, "http://a:1", inputs), &task()).unwrap();
        let frame: Vec<u8> = (0..16).collect();
        let step = Step { frame: &frame, proprioception: &[1.0, 2.0, 3.0], executed: Some(&[7.0, 8.0]) };
        let values: Vec<Value<'_>> = inputs.values(&step).unwrap().into_iter().map(|(_, value)| value).collect();
        assert_eq!(
            values,
            [
                Value::Bytes([1, 2, 3], frame[10..16].into()),
                Value::Bytes([3, 1, 2], vec![0, 3, 1, 4, 2, 5].into()),
                Value::Words([1, 2], &frame[6..10]),
                Value::Numbers(vec![1.0, 2.0, 3.0].into()),
                Value::Numbers(vec![3.0].into()),
                Value::Numbers(vec![7.0, 8.0].into()),
                Value::Text("pick"),
            ]
        );
        let first = Step { executed: None, ..step };
        assert_eq!(inputs.values(&first).unwrap()[5].1, Value::Numbers(vec![0.0, 0.0].into()));
        assert!(inputs.values(&Step { frame: &frame[1..], ..step }).is_err());
        assert!(inputs.values(&Step { executed: Some(&[1.0]), ..step }).is_err());
    }
}
