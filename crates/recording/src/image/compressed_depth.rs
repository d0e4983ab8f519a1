//! Depth as ROS's `compressedDepth` holds it, where the bytes alone do not show it: in RVL, or in metres, of which the file
//! has 16 bits of their inverse after the two numbers that restore them.

use gleaner_core::PictureSizes;
use image::{DynamicImage, ImageFormat};

use super::raw::millimetres;
use super::{Header, PNG_MAGIC, ROS_DEPTH_PREFIX, broken, decode, fit, header_of, rvl};
use crate::error::RecordingError;

/// Places of the two numbers in the bytes before the image.
const SCALE: usize = 4;
const OFFSET: usize = 8;

/// The kind of an image by the format of its message, such as `16UC1; compressedDepth rvl` or `32FC1; compressedDepth png`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct CompressedDepth {
    /// Whether the values are inverse metres rather than millimetres.
    inverse: bool,
    rvl: bool,
}

impl CompressedDepth {
    /// `None` for formats whose bytes show what they are, such as `16UC1; compressedDepth png`.
    pub(crate) fn of(format: &str, bytes: &[u8]) -> Option<Self> {
        let (encoding, codec) = format.split_once("compressedDepth")?;
        // Drivers fill in any format: a PNG is one.
        let png = bytes.get(ROS_DEPTH_PREFIX..).is_some_and(|image| image.starts_with(PNG_MAGIC));
        let found = Self { inverse: encoding.starts_with("32FC1"), rvl: codec.trim() == "rvl" && !png };
        (found.inverse || found.rvl).then_some(found)
    }

    /// What the header shows.
    ///
    /// # Errors
    /// [`RecordingError::BrokenImage`].
    pub(crate) fn header(self, bytes: &[u8]) -> Result<Header, RecordingError> {
        if !self.rvl {
            return header_of(bytes);
        }
        Ok(Header { codec: "rvl", size: rvl::size(image(bytes))?, depth: true })
    }

    /// Decodes to the pixels of a step, height × width 16-bit little-endian millimetres.
    ///
    /// # Errors
    /// [`RecordingError::WrongSize`] or [`RecordingError::BrokenImage`].
    pub(crate) fn decode(self, bytes: &[u8], sizes: &PictureSizes) -> Result<Vec<u8>, RecordingError> {
        let (values, found) =
            if self.rvl { rvl::values(image(bytes), sizes)? } else { png_values(image(bytes), sizes)? };
        if !self.inverse {
            return fit::depth(values.into_iter().flat_map(u16::to_le_bytes).collect(), found, sizes);
        }
        let number = |at: usize| {
            let number = bytes.get(at..at + 4).and_then(|bytes| bytes.try_into().ok()).map(f32::from_le_bytes);
            let unusable = || broken("the numbers before the compressed depth cannot be used; record it again");
            number.filter(|number| number.is_finite()).ok_or_else(unusable)
        };
        let (scale, offset) = (number(SCALE)?, number(OFFSET)?);
        let restored = values.into_iter().flat_map(|inverse| {
            // 0 means no reading.
            let metres = if inverse == 0 { f32::NAN } else { scale / (f32::from(inverse) - offset) };
            millimetres(metres).to_le_bytes()
        });
        fit::depth(restored.collect(), found, sizes)
    }
}

/// The bytes after ROS's own.
fn image(bytes: &[u8]) -> &[u8] {
    bytes.get(ROS_DEPTH_PREFIX..).unwrap_or_default()
}

fn png_values(bytes: &[u8], sizes: &PictureSizes) -> Result<(Vec<u16>, (u32, u32)), RecordingError> {
    let image = decode(bytes, ImageFormat::Png, sizes)?;
    let found = (image.height(), image.width());
    let DynamicImage::ImageLuma16(image) = image else {
        return Err(broken(format!("the PNG of compressed depth has {:?} pixels, not 16-bit gray", image.color())));
    };
    Ok((image.into_raw(), found))
}
