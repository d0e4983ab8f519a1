//! The shape of one step of a task: its cameras, proprioception and action.

use gleaner_core::action::ActionRanges;
use gleaner_core::{Augmentation, CameraSpec, PictureSizes, RecordedSize, TaskSpec};
use serde::{Deserialize, Serialize};

use crate::error::{LearnError, within};

const MAX_CAMERAS: usize = 16;
const MAX_DIMENSIONS: usize = 4096;
const IMAGE_SIDE: (u32, u32) = (8, 2048);

/// The contents of one step: images o, proprioception m and action a.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TaskShape {
    /// The cameras, in the order of their images in a frame.
    pub cameras: Vec<CameraShape>,
    /// Number of proprioception values M.
    pub proprioception: usize,
    /// Number of action values A.
    pub action: usize,
    /// The values that the robot executes.
    #[serde(default, skip_serializing_if = "free")]
    pub ranges: ActionRanges,
}

fn free(ranges: &ActionRanges) -> bool {
    ranges.each().is_empty()
}

/// One camera's image.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraShape {
    /// The camera's name in the task, for messages.
    pub name: String,
    /// Height in pixels.
    pub height: u32,
    /// Width in pixels.
    pub width: u32,
    /// Whether a depth image of the same size follows the colour image.
    #[serde(default)]
    pub depth: bool,
    /// The size of the images that robots send, if it is another: what was cropped and resized for training is for serving.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub recorded: Option<RecordedSize>,
}

impl CameraShape {
    /// Number of pixels of one image.
    pub(crate) fn pixels(&self) -> usize {
        self.height as usize * self.width as usize
    }

    /// Channels of the model's input: 3, or 4 with depth.
    pub(crate) fn channels(&self) -> usize {
        if self.depth { 4 } else { 3 }
    }

    /// The sizes of its images, as they are sent and as the model reads them.
    pub fn sizes(&self) -> PictureSizes {
        PictureSizes { height: self.height, width: self.width, recorded: self.recorded }
    }

    /// Bytes of one image: `H*W*3` of RGB, then `H*W*2` of depth if there is any.
    pub fn bytes(&self) -> usize {
        self.pixels() * if self.depth { 5 } else { 3 }
    }
}

/// Fails if a shift could move a whole image out of view.
pub(crate) fn augmentation_fits(augmentation: &Augmentation, shape: &TaskShape) -> Result<(), LearnError> {
    let sides = shape.cameras.iter().flat_map(|camera| [camera.height, camera.width]);
    let most = sides.min().unwrap_or(1).saturating_sub(1);
    within("shift_pixels", f64::from(augmentation.shift_pixels), 0.0, f64::from(most))
}

impl From<&TaskSpec> for TaskShape {
    fn from(spec: &TaskSpec) -> Self {
        let camera = |camera: &CameraSpec| CameraShape {
            name: camera.name.clone(),
            height: camera.height,
            width: camera.width,
            depth: camera.depth,
            recorded: camera.recorded,
        };
        Self {
            cameras: spec.cameras.iter().map(camera).collect(),
            proprioception: spec.proprioception_size(),
            action: spec.action_size(),
            ranges: ActionRanges::of(&spec.action),
        }
    }
}

impl TaskShape {
    /// Bytes of one step's images.
    pub fn frame_bytes(&self) -> usize {
        self.cameras.iter().map(CameraShape::bytes).sum()
    }

    /// Checks every field.
    ///
    /// # Errors
    /// [`LearnError::Invalid`] names the field.
    pub fn validate(&self) -> Result<(), LearnError> {
        if self.cameras.is_empty() || self.cameras.len() > MAX_CAMERAS {
            let count = self.cameras.len();
            return Err(LearnError::invalid(
                "shape.cameras",
                format!("has {count} cameras, must have between 1 and {MAX_CAMERAS}"),
            ));
        }
        let (low, high) = (f64::from(IMAGE_SIDE.0), f64::from(IMAGE_SIDE.1));
        for (i, camera) in self.cameras.iter().enumerate() {
            let path = format!("shape.cameras[{i}] ({})", camera.name);
            within(&format!("{path}.height"), f64::from(camera.height), low, high)?;
            within(&format!("{path}.width"), f64::from(camera.width), low, high)?;
        }
        for (field, count) in [("shape.proprioception", self.proprioception), ("shape.action", self.action)] {
            if count == 0 || count > MAX_DIMENSIONS {
                return Err(LearnError::invalid(
                    field,
                    format!("has {count} values, must have between 1 and {MAX_DIMENSIONS}"),
                ));
            }
        }
        if !free(&self.ranges) && self.ranges.each().len() != self.action {
            return Err(LearnError::invalid("shape.ranges", format!("must have {} values", self.action)));
        }
        Ok(())
    }
}
