//! Random changes to the images a model learns from.

use serde::{Deserialize, Serialize};

use super::within;
use crate::error::LearnError;

/// Random changes to the images of a training batch; none by default. All frames of one episode in
/// a batch change alike, so that what moves between them moves as it did.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Augmentation {
    /// Images move by up to this many pixels along each axis, their edge repeated.
    pub shift_pixels: u32,
    /// Colour is lightened or darkened by up to this part of full scale, 0 … 1.
    pub brightness: f64,
    /// Colour is stretched about its image's mean by a factor in 1 ± this, 0 … 1.
    pub contrast: f64,
}

impl Augmentation {
    /// Whether nothing changes.
    pub(crate) fn is_none(&self) -> bool {
        *self == Self::default()
    }

    pub(crate) fn validate(&self) -> Result<(), LearnError> {
        within("augmentation.shift_pixels", f64::from(self.shift_pixels), 0.0, 1024.0)?;
        within("augmentation.brightness", self.brightness, 0.0, 1.0)?;
        within("augmentation.contrast", self.contrast, 0.0, 1.0)
    }
}
