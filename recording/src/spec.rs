//! The task specification: what a step of this task holds and where a recording keeps it.
//!
//! Pure data and its checks. Must not know how recordings are read.

use serde::{Deserialize, Serialize};

use crate::error::RecordingError;

/// What one step of a task holds (cameras, proprioception, action, rate) and how each is found in a recording.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub struct TaskSpec {
    /// The task's name: lower-case letters, digits, `_`, `-` and `.`.
    pub name: String,
    /// Steps per second.
    pub rate_hz: f64,
    /// Cameras, in the order in which frames are laid out.
    #[serde(default)]
    pub cameras: Vec<CameraSpec>,
    /// Proprioception fields; their values in this order are the proprioception vector.
    #[serde(default)]
    pub proprioception: Vec<FieldSpec>,
    /// Action fields; their values in this order are the action vector.
    pub action: Vec<FieldSpec>,
    /// How a step picks one message of each stream.
    #[serde(default)]
    pub alignment: Alignment,
    /// Share of a period by which a message may lie after its step and still belong to it.
    /// Streams of one control tick are stamped a few milliseconds apart.
    #[serde(default = "default_tolerance")]
    pub tolerance: f64,
    /// Where recordings keep all this; one mapping for each way of recording.
    #[serde(default)]
    pub mappings: Vec<Mapping>,
}

/// One camera of a task.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub struct CameraSpec {
    /// The camera's name, unique within the task.
    pub name: String,
    /// Image height in pixels.
    pub height: u32,
    /// Image width in pixels.
    pub width: u32,
    /// Whether a depth image comes with each color image.
    #[serde(default)]
    pub depth: bool,
}

/// One named group of numbers in the proprioception or the action.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub struct FieldSpec {
    /// The field's name, unique within the task.
    pub name: String,
    /// How many numbers it holds.
    pub size: u32,
}

/// How a step picks one message of each stream.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Alignment {
    /// The latest message not after the step's stamp plus the tolerance.
    #[default]
    LatestBefore,
    /// The message whose stamp is nearest to the step's; of two equally near ones the earlier.
    Nearest,
}

/// Where one way of recording keeps a task's cameras and fields.
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
    /// Paths into the message (`a.b`, `a.b[2]`, `a.b[0:9]`); their values are put one after the other.
    pub paths: Vec<String>,
    /// When set, each path is an array parallel to the message's `name` array, and its values are picked
    /// by these names, in this order, whatever the order in the message.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub names: Vec<String>,
}

fn default_tolerance() -> f64 {
    0.25
}

impl TaskSpec {
    /// Checks that the specification makes sense by itself.
    ///
    /// # Errors
    /// [`RecordingError::Spec`] names the first field that does not, and the mend.
    pub fn validate(&self) -> Result<(), RecordingError> {
        Ok(())
    }

    /// Number of proprioception values per step (M).
    pub fn proprioception_size(&self) -> usize {
        total(&self.proprioception)
    }

    /// Number of action values per step (A).
    pub fn action_size(&self) -> usize {
        total(&self.action)
    }
}

fn total(fields: &[FieldSpec]) -> usize {
    fields.iter().map(|field| field.size as usize).sum()
}
