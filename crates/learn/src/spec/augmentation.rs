//! Random changes to the images a model learns from.

use serde::{Deserialize, Serialize};

use super::{TaskShape, within};
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

    /// Fails if a shift could push a whole image out of sight.
    pub(crate) fn fits(&self, shape: &TaskShape) -> Result<(), LearnError> {
        let sides = shape.cameras.iter().flat_map(|camera| [camera.height, camera.width]);
        let most = sides.min().unwrap_or(1).saturating_sub(1);
        within("augmentation.shift_pixels", f64::from(self.shift_pixels), 0.0, f64::from(most))
    }

    pub(crate) fn validate(&self) -> Result<(), LearnError> {
        within("augmentation.shift_pixels", f64::from(self.shift_pixels), 0.0, 1024.0)?;
        within("augmentation.brightness", self.brightness, 0.0, 1.0)?;
        within("augmentation.contrast", self.contrast, 0.0, 1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::toy;

    #[test]
    fn a_shift_as_wide_as_the_image_is_refused() {
        let shift = |shift_pixels| Augmentation { shift_pixels, ..Augmentation::default() };
        assert!(shift(toy::SIDE - 1).fits(&toy::shape()).is_ok());
        let error = shift(toy::SIDE).fits(&toy::shape()).unwrap_err().to_string();
        assert!(error.starts_with("augmentation.shift_pixels: is 16") && error.contains("15"), "{error}");
    }
}
