//! The task specification: the content of a step, and its place in recordings.
//!
//! Plain data, which `gleaner-recording` checks. This module does not depend on the reader.

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};

use crate::bound::Bound;
use crate::picture_sizes::{PictureSizes, RecordedSize};

/// The content of a task's steps (cameras, proprioception, action, rate) and its place in recordings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub struct TaskSpec {
    /// The task's name: letters, digits, `_`, `-` and `.`.
    pub name: String,
    /// What the robot does, in words, such as `pick up the red cube`: the text of the task in a LeRobot export. It can change
    /// at any time.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub instruction: String,
    /// Steps per second.
    pub rate_hz: f64,
    /// Cameras, in the order of the frames in memory.
    #[serde(default)]
    pub cameras: Vec<CameraSpec>,
    /// Proprioception fields; their values in this order are the proprioception vector.
    #[serde(default)]
    pub proprioception: Vec<FieldSpec>,
    /// Action fields; their values in this order are the action vector.
    pub action: Vec<FieldSpec>,
    /// The choice of a step's message in each stream.
    #[serde(default)]
    pub alignment: Alignment,
    /// Share of a period by which a message may lie after its step and still belong to it.
    /// Streams of one control tick are stamped a few milliseconds apart.
    #[serde(default = "default_tolerance")]
    pub tolerance: f64,
    /// The places of cameras and fields, one mapping for each way of recording.
    #[serde(default)]
    pub mappings: Vec<Mapping>,
    /// Keys that clients of openpi's protocol send, where they are not the names of the task. They can change at any time.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub openpi: Vec<OpenpiKey>,
}

/// The key of a camera or a proprioception field in the observations of openpi's clients, such as
/// `observation/wrist_image` of LIBERO's. A camera without one is read from `observation/NAME`, `images/NAME` or
/// `image/NAME`, and values from one vector `observation/state` or from `observation/NAME`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub struct OpenpiKey {
    /// Name of the camera or of the proprioception field in the task.
    pub name: String,
    /// The client's key; of nested maps, their keys joined by `/`. The depth of a camera has the same with `_depth` after it.
    pub key: String,
}

/// One camera of a task.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub struct CameraSpec {
    /// The camera's name, unique within the task.
    pub name: String,
    /// Height in pixels of a step's picture.
    pub height: u32,
    /// Width in pixels of a step's picture.
    pub width: u32,
    /// Whether a depth image comes with each color image.
    #[serde(default)]
    pub depth: bool,
    /// The size of its pictures in recordings and observations, if it is not that of a step.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub recorded: Option<RecordedSize>,
}

impl CameraSpec {
    /// The sizes of its pictures.
    pub fn sizes(&self) -> PictureSizes {
        PictureSizes { height: self.height, width: self.width, recorded: self.recorded }
    }
}

/// One named group of numbers in the proprioception or the action.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub struct FieldSpec {
    /// The field's name, unique within the task.
    pub name: String,
    /// The number of its values.
    pub size: u32,
    /// What its values are measured in, such as `rad`, or, where they differ, `m, then no unit`: for people; nothing is
    /// converted. It can change at any time.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub unit: String,
    /// In an action: the least value that the robot executes; where values differ, a list with one for each.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub minimum: Option<Bound>,
    /// In an action: the greatest value that the robot executes; where values differ, a list with one for each.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub maximum: Option<Bound>,
    /// In an action: each value is `minimum` or `maximum` and nothing between, such as a gripper's command.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub binary: bool,
}

/// The choice of a step's message in each stream.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Alignment {
    /// The latest message not after the step's stamp plus the tolerance.
    #[default]
    LatestBefore,
    /// The message whose stamp is nearest to the step's; of two equally near ones the earlier.
    Nearest,
}

/// The topics of a task's cameras and fields in one way of recording.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub struct Mapping {
    /// The mapping's name, unique within the task.
    pub name: String,
    /// One source for each camera of the task.
    #[serde(default)]
    pub cameras: Vec<CameraSource>,
    /// One source for each proprioception and action field of the task.
    pub fields: Vec<FieldSource>,
    /// Topic whose stamps are the steps; by default the first action field's topic.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clock: Option<String>,
}

/// The topics of one camera.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub struct CameraSource {
    /// Name of the camera in the task.
    pub camera: String,
    /// Topic of the color images.
    pub color: String,
    /// Topic of the depth images, if the camera has depth.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub depth: Option<String>,
}

/// The topic and paths of one field.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub struct FieldSource {
    /// Name of the field in the task.
    pub field: String,
    /// Topic of the messages.
    pub topic: String,
    /// Paths into the message (`a.b`, `a.b[2]`, `a.b[0:9]`); their values are concatenated. None with a `transform`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub paths: Vec<String>,
    /// If set, each path is an array parallel to the message's `name` array, and its values are picked
    /// by these names, in this order, whatever the order in the message.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub names: Vec<String>,
    /// If set, the field is the pose of a frame, from the transforms on this topic, such as `/tf`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub transform: Option<Transform>,
}

/// The pose of a frame in another, from the transforms between frames that a robot publishes (`tf2_msgs/TFMessage`,
/// `foxglove.FrameTransforms`): the position x, y, z and the quaternion x, y, z, w, seven values.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub struct Transform {
    /// Frame in which the pose is, such as `base_link`.
    pub parent: String,
    /// Frame whose pose it is, such as `tool0`.
    pub child: String,
    /// Topic of the transforms that never change; empty: the robot has no such topic.
    #[serde(default = "default_static_topic")]
    pub static_topic: String,
}

impl Transform {
    /// Number of values of a pose.
    pub const SIZE: u32 = 7;
}

fn default_tolerance() -> f64 {
    0.25
}

/// The topic of ROS.
pub(crate) fn default_static_topic() -> String {
    "/tf_static".to_owned()
}

impl FieldSpec {
    /// A field whose values are free.
    pub fn new(name: impl Into<String>, size: u32) -> Self {
        Self { name: name.into(), size, unit: String::new(), minimum: None, maximum: None, binary: false }
    }
}

impl TaskSpec {
    /// This specification without what can change at any time, because no step depends on it: the instruction, units, and
    /// the keys of clients.
    #[must_use]
    pub fn of_steps(&self) -> Self {
        let unitless = |fields: &[FieldSpec]| -> Vec<FieldSpec> {
            fields.iter().map(|field| FieldSpec { unit: String::new(), ..field.clone() }).collect()
        };
        Self {
            instruction: String::new(),
            openpi: Vec::new(),
            proprioception: unitless(&self.proprioception),
            action: unitless(&self.action),
            ..self.clone()
        }
    }

    /// Number of proprioception values per step (M).
    pub fn proprioception_size(&self) -> usize {
        total(&self.proprioception)
    }

    /// Number of action values per step (A).
    pub fn action_size(&self) -> usize {
        total(&self.action)
    }

    /// Size of a field by name; 0 for an unknown name.
    pub fn field_size(&self, name: &str) -> usize {
        let fields = self.proprioception.iter().chain(&self.action);
        fields.filter(|field| field.name == name).map(|field| field.size as usize).sum()
    }
}

impl Mapping {
    /// Topic whose stamps are the steps.
    pub fn clock_topic(&self, spec: &TaskSpec) -> Option<&str> {
        let first = spec.action.first()?;
        let source = || self.fields.iter().find(|source| source.field == first.name);
        self.clock.as_deref().or_else(|| source().map(|source| source.topic.as_str()))
    }

    /// Every topic that this mapping reads, once.
    pub fn topics(&self, spec: &TaskSpec) -> BTreeSet<&str> {
        let cameras = self.cameras.iter().flat_map(|source| [Some(source.color.as_str()), source.depth.as_deref()]);
        let fields = self.fields.iter().map(|source| Some(source.topic.as_str()));
        cameras.chain(fields).chain([self.clock_topic(spec)]).flatten().collect()
    }

    /// The topics with transforms of poses that this mapping reads, once. Each of their messages depends on earlier ones.
    pub fn transform_topics(&self) -> BTreeSet<&str> {
        self.fields.iter().filter(|source| source.transform.is_some()).map(|source| source.topic.as_str()).collect()
    }

    /// The topics with transforms that never change, once. A recording may lack them.
    pub fn static_topics(&self) -> BTreeSet<&str> {
        let transforms = self.fields.iter().filter_map(|source| source.transform.as_ref());
        transforms.map(|transform| transform.static_topic.as_str()).filter(|topic| !topic.is_empty()).collect()
    }
}

fn total(fields: &[FieldSpec]) -> usize {
    fields.iter().map(|field| field.size as usize).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn survives_json_and_refuses_unknown_keys() {
        let spec: TaskSpec = serde_json::from_str(
            r#"{"name":"t","rate_hz":5,"action":[{"name":"a","size":3}],"mappings":[{"name":"m","fields":[]}]}"#,
        )
        .unwrap();
        let text = serde_json::to_string(&spec).unwrap();
        assert_eq!(serde_json::from_str::<TaskSpec>(&text).unwrap(), spec);
        let strange = text.replacen("\"rate_hz\"", "\"rate\"", 1);
        assert!(serde_json::from_str::<TaskSpec>(&strange).unwrap_err().to_string().contains("rate"));
    }

    #[test]
    fn missing_keys_have_defaults() {
        let spec: TaskSpec =
            serde_json::from_str(r#"{"name":"t","rate_hz":5,"action":[{"name":"a","size":3}]}"#).unwrap();
        assert_eq!(spec.tolerance, 0.25);
        assert_eq!(spec.alignment, Alignment::LatestBefore);
        assert_eq!((spec.proprioception_size(), spec.action_size()), (0, 3));
    }
}
