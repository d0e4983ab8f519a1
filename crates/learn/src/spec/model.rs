//! Which model, and where it runs.

use serde::{Deserialize, Serialize};

use super::within;
use crate::error::LearnError;

/// Size of the model.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Preset {
    /// 64 wide, 2 layers: for tests, demos and images up to about 64 pixels a side.
    Tiny,
    /// 128 wide, 4 layers: for 128-pixel images on a few CPU cores or a small GPU.
    #[default]
    Small,
    /// 256 wide, 4 layers: for a GPU.
    Base,
}

/// The encoder's size and how much history it sees.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ModelSpec {
    /// Size of the model.
    pub preset: Preset,
    /// The paper's l: a segment is `l + 1` steps.
    pub segment_length: u32,
}

impl Default for ModelSpec {
    fn default() -> Self {
        Self { preset: Preset::default(), segment_length: 6 }
    }
}

impl ModelSpec {
    /// Steps in a segment, `l + 1`.
    pub fn window(&self) -> usize {
        self.segment_length as usize + 1
    }

    pub(crate) fn validate(&self) -> Result<(), LearnError> {
        let length = f64::from(self.segment_length);
        within("model.segment_length", length, 0.0, 63.0)
    }
}

/// Where tensors live.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Device {
    /// The processor: numbers repeat bit for bit.
    #[default]
    Cpu,
    /// The first CUDA device: faster, numbers repeat only nearly.
    Cuda,
}
