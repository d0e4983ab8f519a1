//! Uncompressed images as cameras send them: pixel encodings, padded rows and byte orders.

use gleaner_core::PictureSizes;

use super::{broken, fit};
use crate::error::RecordingError;

/// An uncompressed image, as a message describes it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RawImage<'a> {
    pub(crate) height: u32,
    pub(crate) width: u32,
    /// Such as `rgb8`, `bgra8`, `16UC1`.
    pub(crate) encoding: &'a str,
    /// Bytes from one row to the next.
    pub(crate) step: u32,
    pub(crate) big_endian: bool,
    pub(crate) data: &'a [u8],
}

/// Converts to the pixels of a step, height × width × 3 bytes of RGB.
pub(crate) fn raw_color(image: RawImage<'_>, sizes: &PictureSizes) -> Result<Vec<u8>, RecordingError> {
    let found = (image.height, image.width);
    fit::check_size(sizes, found)?;
    // The bytes of a pixel, and the places of red, green and blue.
    let (bytes, order) = match image.encoding {
        "rgb8" => (3, [0, 1, 2]),
        "bgr8" | "8UC3" => (3, [2, 1, 0]),
        "rgba8" => (4, [0, 1, 2]),
        "bgra8" | "8UC4" => (4, [2, 1, 0]),
        "mono8" | "8UC1" => (1, [0, 0, 0]),
        other => {
            return Err(broken(format!(
                "color images encoded as `{other}` cannot be read; use rgb8, rgba8, bgr8, bgra8, mono8 or a compressed image"
            )));
        }
    };
    let mut out = Vec::with_capacity(image.rows(bytes)?.map(<[u8]>::len).sum::<usize>() / bytes * 3);
    for row in image.rows(bytes)? {
        for pixel in row.chunks_exact(bytes) {
            out.extend(order.map(|at| pixel.get(at).copied().unwrap_or_default()));
        }
    }
    fit::color(out, found, sizes)
}

/// Converts to the pixels of a step, height × width 16-bit little-endian millimetres. Metres that are not finite or not above
/// zero become 0, which means no reading.
pub(crate) fn raw_depth(image: RawImage<'_>, sizes: &PictureSizes) -> Result<Vec<u8>, RecordingError> {
    let found = (image.height, image.width);
    fit::check_size(sizes, found)?;
    let mut out = Vec::new();
    match image.encoding {
        "16UC1" | "mono16" => {
            for row in image.rows(2)? {
                if image.big_endian {
                    out.extend(row.as_chunks().0.iter().flat_map(|&[high, low]| [low, high]));
                } else {
                    out.extend_from_slice(row);
                }
            }
        }
        "32FC1" => {
            for row in image.rows(4)? {
                for pixel in row.as_chunks::<4>().0 {
                    let metres = if image.big_endian { f32::from_be_bytes(*pixel) } else { f32::from_le_bytes(*pixel) };
                    out.extend(millimetres(metres).to_le_bytes());
                }
            }
        }
        other => {
            return Err(broken(format!(
                "depth images encoded as `{other}` cannot be read; use 16UC1 (millimetres) or 32FC1 (metres)"
            )));
        }
    }
    fit::depth(out, found, sizes)
}

pub(super) fn millimetres(metres: f32) -> u16 {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates; NaN becomes 0")]
    let whole = (metres * 1000.0).round() as u16;
    if metres.is_finite() { whole } else { 0 }
}

impl<'a> RawImage<'a> {
    /// The rows without their padding, for pixels of this size. All lengths are checked first.
    fn rows(&self, pixel_bytes: usize) -> Result<impl Iterator<Item = &'a [u8]> + use<'a>, RecordingError> {
        let (height, width, step) = (self.height as usize, self.width as usize, self.step as usize);
        let row = width.checked_mul(pixel_bytes);
        // A step of zero is unset: the rows have no padding.
        let step = if step == 0 { row.unwrap_or_default() } else { step };
        let needed = height.checked_sub(1).and_then(|rows| rows.checked_mul(step)).zip(row);
        let needed = needed.and_then(|(before, row)| before.checked_add(row));
        let (Some(row), Some(needed)) = (row, needed) else {
            return Err(broken("the image's size overflows; record it again"));
        };
        if row == 0 || step < row || needed > self.data.len() {
            return Err(broken(format!(
                "{}×{} pixels of {} with {step} bytes a row need {needed} bytes, but the message has {}; record it again",
                self.height,
                self.width,
                self.encoding,
                self.data.len()
            )));
        }
        let data = self.data;
        Ok(data.chunks(step).take(height).filter_map(move |chunk| chunk.get(..row)))
    }
}

#[cfg(test)]
mod tests {

    use super::*;

    fn image<'a>(encoding: &'a str, step: u32, data: &'a [u8]) -> RawImage<'a> {
        RawImage { height: 2, width: 1, encoding, step, big_endian: false, data }
    }

    #[test]
    fn every_color_encoding_becomes_rgb() {
        for (encoding, data) in [
            ("rgb8", &[1, 2, 3, 4, 5, 6][..]),
            ("bgr8", &[3, 2, 1, 6, 5, 4]),
            ("8UC3", &[3, 2, 1, 6, 5, 4]),
            ("rgba8", &[1, 2, 3, 9, 4, 5, 6, 9]),
            ("bgra8", &[3, 2, 1, 9, 6, 5, 4, 9]),
        ] {
            assert_eq!(
                raw_color(image(encoding, 0, data), &PictureSizes::new(2, 1)).unwrap(),
                [1, 2, 3, 4, 5, 6],
                "{encoding}"
            );
        }
        assert_eq!(raw_color(image("mono8", 1, &[7, 8]), &PictureSizes::new(2, 1)).unwrap(), [7, 7, 7, 8, 8, 8]);
    }

    #[test]
    fn padding_is_skipped_even_when_the_last_row_has_none() {
        let padded = [1, 2, 3, 0, 0, 4, 5, 6];
        assert_eq!(raw_color(image("rgb8", 5, &padded), &PictureSizes::new(2, 1)).unwrap(), [1, 2, 3, 4, 5, 6]);
        assert_eq!(raw_depth(image("16UC1", 4, &[1, 2, 0, 0, 3, 4]), &PictureSizes::new(2, 1)).unwrap(), [1, 2, 3, 4]);
    }

    #[test]
    fn depth_becomes_little_endian_millimetres() {
        let big = RawImage { big_endian: true, ..image("16UC1", 2, &[1, 2, 3, 4]) };
        assert_eq!(raw_depth(big, &PictureSizes::new(2, 1)).unwrap(), [2, 1, 4, 3]);
        let metres = [1.2345f32.to_le_bytes(), f32::NAN.to_le_bytes()].concat();
        assert_eq!(
            raw_depth(image("32FC1", 4, &metres), &PictureSizes::new(2, 1)).unwrap(),
            [1235u16.to_le_bytes(), [0, 0]].concat()
        );
        assert_eq!((millimetres(f32::INFINITY), millimetres(-1.0), millimetres(99.0)), (0, 0, 65535));
    }

    #[test]
    fn short_or_unsupported_images_are_errors() {
        assert!(
            raw_color(image("rgb8", 3, &[0; 5]), &PictureSizes::new(2, 1))
                .unwrap_err()
                .to_string()
                .contains("need 6 bytes")
        );
        assert!(raw_color(image("rgb8", 2, &[0; 9]), &PictureSizes::new(2, 1)).is_err());
        assert!(
            raw_color(image("yuv422", 2, &[0; 9]), &PictureSizes::new(2, 1))
                .unwrap_err()
                .to_string()
                .contains("yuv422")
        );
        assert!(
            raw_depth(image("rgb8", 3, &[0; 9]), &PictureSizes::new(2, 1)).unwrap_err().to_string().contains("16UC1")
        );
        assert!(matches!(
            raw_color(image("rgb8", 3, &[0; 6]), &PictureSizes::new(3, 1)),
            Err(RecordingError::WrongSize { .. })
        ));
        let huge = RawImage { height: u32::MAX, width: u32::MAX, ..image("rgb8", u32::MAX, &[0; 9]) };
        assert!(raw_color(huge, &PictureSizes::new(u32::MAX, u32::MAX)).is_err());
    }
}
