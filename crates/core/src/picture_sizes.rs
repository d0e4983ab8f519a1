//! The sizes of a camera's pictures: in recordings and observations, and in steps.
//!
//! Plain data. The pixels are cropped and resized in `gleaner-recording`.

use serde::{Deserialize, Serialize};

/// The pictures of a camera in recordings and observations, where they are larger than, or cut otherwise than, those of
/// a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub struct RecordedSize {
    /// Height in pixels.
    pub height: u32,
    /// Width in pixels.
    pub width: u32,
    /// The part that a step shows; by default the whole picture.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub crop: Option<Crop>,
}

/// A part of a picture, in its pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub struct Crop {
    /// First row.
    pub top: u32,
    /// First column.
    pub left: u32,
    /// Number of rows.
    pub height: u32,
    /// Number of columns.
    pub width: u32,
}

/// The sizes of one camera's pictures.
///
/// A picture of the recorded size is cropped and resized to the size of a step. A picture that already has the size of a
/// step is used as it is, so a robot can send small pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PictureSizes {
    /// Height of a step's picture in pixels.
    pub height: u32,
    /// Width of a step's picture in pixels.
    pub width: u32,
    /// The size in recordings and observations, if it is another.
    pub recorded: Option<RecordedSize>,
}

impl PictureSizes {
    /// Pictures that are recorded at the size of a step.
    pub fn new(height: u32, width: u32) -> Self {
        Self { height, width, recorded: None }
    }

    /// (height, width) in recordings and observations.
    pub fn recorded(&self) -> (u32, u32) {
        self.recorded.map_or((self.height, self.width), |recorded| (recorded.height, recorded.width))
    }

    /// (height, width) in a step.
    pub fn step(&self) -> (u32, u32) {
        (self.height, self.width)
    }

    /// The part of a recorded picture that a step shows.
    pub fn crop(&self) -> Crop {
        let (height, width) = self.recorded();
        let whole = Crop { top: 0, left: 0, height, width };
        self.recorded.and_then(|recorded| recorded.crop).unwrap_or(whole)
    }
}
