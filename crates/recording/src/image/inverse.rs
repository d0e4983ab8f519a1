//! Depth in metres as ROS's `compressedDepth` holds it: 16 bits of its inverse in a PNG, after the two numbers that restore
//! it.

use gleaner_core::PictureSizes;
use image::{DynamicImage, ImageFormat};

use super::raw::millimetres;
use super::{broken, decode, fit, without_ros_prefix};
use crate::error::RecordingError;

/// Places of the two numbers in the bytes before the PNG.
const SCALE: usize = 4;
const OFFSET: usize = 8;

/// Whether the format of a message names depth in metres of this kind, such as `32FC1; compressedDepth png`.
pub(crate) fn is_inverse(format: &str) -> bool {
    format.starts_with("32FC1") && format.contains("compressedDepth")
}

/// Decodes to the pixels of a step, height × width 16-bit little-endian millimetres.
///
/// # Errors
/// [`RecordingError::WrongSize`] or [`RecordingError::BrokenImage`].
pub(crate) fn inverse_depth(bytes: &[u8], sizes: &PictureSizes) -> Result<Vec<u8>, RecordingError> {
    let number = |at: usize| {
        let number = bytes.get(at..at + 4).and_then(|bytes| bytes.try_into().ok()).map(f32::from_le_bytes);
        let missing = || broken("the compressed depth ends before its PNG; record it again");
        number.filter(|number| number.is_finite()).ok_or_else(missing)
    };
    let (scale, offset) = (number(SCALE)?, number(OFFSET)?);
    let image = decode(without_ros_prefix(bytes), ImageFormat::Png, sizes)?;
    let found = (image.height(), image.width());
    let DynamicImage::ImageLuma16(image) = image else {
        return Err(broken(format!("the PNG of compressed depth has {:?} pixels, not 16-bit gray", image.color())));
    };
    let restored = image.into_raw().into_iter().flat_map(|inverse| {
        // 0 means no reading.
        let metres = if inverse == 0 { f32::NAN } else { scale / (f32::from(inverse) - offset) };
        millimetres(metres).to_le_bytes()
    });
    fit::depth(restored.collect(), found, sizes)
}
