//! Pixels in and out: color images to RGB bytes, depth images to millimetres.
//!
//! Every size is checked before memory is reserved for it. Must not know messages or topics.

use crate::error::RecordingError;

/// How an image's bytes are to be read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PixelFormat {
    /// Baseline or progressive JPEG.
    Jpeg,
    /// PNG; for depth, 16-bit gray in millimetres.
    Png,
    /// height × width × 3 bytes, row-major, red first.
    Rgb8,
    /// height × width 16-bit little-endian millimetres, row-major.
    Depth16,
    /// By the first bytes (JPEG, PNG or WebP), else raw of the exact size.
    #[default]
    Auto,
}

/// Decodes a color image to height × width × 3 bytes of RGB.
///
/// # Errors
/// [`RecordingError::WrongSize`] or [`RecordingError::BrokenImage`].
pub fn decode_color(
    bytes: &[u8],
    format: PixelFormat,
    height: u32,
    width: u32,
) -> Result<Vec<u8>, RecordingError> {
    let _ = (bytes, format, height, width);
    Err(RecordingError::BrokenImage {
        problem: "not there yet".into(),
    })
}

/// Decodes a depth image to height × width 16-bit little-endian millimetres.
///
/// # Errors
/// [`RecordingError::WrongSize`] or [`RecordingError::BrokenImage`].
pub fn decode_depth(
    bytes: &[u8],
    format: PixelFormat,
    height: u32,
    width: u32,
) -> Result<Vec<u8>, RecordingError> {
    let _ = (bytes, format, height, width);
    Err(RecordingError::BrokenImage {
        problem: "not there yet".into(),
    })
}

/// Encodes height × width × 3 bytes of RGB as JPEG of this quality (1 to 100).
///
/// # Errors
/// [`RecordingError::BrokenImage`] when the bytes are not of that size.
pub fn encode_jpeg(
    rgb: &[u8],
    height: u32,
    width: u32,
    quality: u8,
) -> Result<Vec<u8>, RecordingError> {
    let _ = (rgb, height, width, quality);
    Err(RecordingError::BrokenImage {
        problem: "not there yet".into(),
    })
}
