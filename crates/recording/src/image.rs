//! Pixels in and out: color images to RGB bytes, depth images to millimetres.
//!
//! Every size is checked before memory is reserved for it, and memory follows the size that is wanted. This module does
//! not depend on messages or topics.

mod compressed_depth;
pub(crate) mod fit;
mod raw;
mod rvl;

use std::io::Cursor;

use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{
    ColorType, DynamicImage, ExtendedColorType, ImageDecoder, ImageEncoder as _, ImageFormat, ImageReader, Limits,
};

use gleaner_core::PictureSizes;

use crate::error::RecordingError;

pub(crate) use compressed_depth::CompressedDepth;
pub(crate) use raw::{RawImage, raw_color, raw_depth};

/// Maximum memory to decode an image in bytes: for each pixel, and for tables and metadata.
const BYTES_PER_PIXEL: u64 = 16;
const BYTES_ASIDE: u64 = 32 << 20;
const PNG_MAGIC: &[u8] = b"\x89PNG\r\n\x1a\n";
/// Bytes that ROS's depth compression puts before its PNG.
const ROS_DEPTH_PREFIX: usize = 12;

/// The format of an image's bytes.
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

/// Decodes a color image to the pixels of a step, height × width × 3 bytes of RGB, cropped and resized if it has the
/// recorded size.
///
/// # Errors
/// [`RecordingError::WrongSize`] or [`RecordingError::BrokenImage`].
pub fn decode_color(bytes: &[u8], format: PixelFormat, sizes: &PictureSizes) -> Result<Vec<u8>, RecordingError> {
    let codec = match format {
        PixelFormat::Jpeg => Some(ImageFormat::Jpeg),
        PixelFormat::Png => Some(ImageFormat::Png),
        PixelFormat::Rgb8 => None,
        PixelFormat::Depth16 => {
            return Err(broken("expected a color image, got depth; send RGB8, JPEG or PNG"));
        }
        PixelFormat::Auto => codec_of(bytes),
    };
    match codec {
        Some(codec) => {
            let image = decode(bytes, codec, sizes)?;
            let found = (image.height(), image.width());
            fit::color(image.into_rgb8().into_raw(), found, sizes)
        }
        None => fit::color(bytes.to_vec(), raw_size(bytes, 3, sizes)?, sizes),
    }
}

/// Decodes a depth image to the pixels of a step, height × width 16-bit little-endian millimetres, cropped and resized if
/// it has the recorded size.
///
/// # Errors
/// [`RecordingError::WrongSize`] or [`RecordingError::BrokenImage`].
pub fn decode_depth(bytes: &[u8], format: PixelFormat, sizes: &PictureSizes) -> Result<Vec<u8>, RecordingError> {
    let bytes = if format == PixelFormat::Auto { without_ros_prefix(bytes) } else { bytes };
    match format {
        PixelFormat::Jpeg | PixelFormat::Rgb8 => {
            return Err(broken("expected a depth image, got color; send 16-bit millimetres raw or as PNG"));
        }
        PixelFormat::Auto if !bytes.starts_with(PNG_MAGIC) && codec_of(bytes).is_some() => {
            return Err(broken("depth is compressed with loss; record it raw or as 16-bit PNG"));
        }
        PixelFormat::Auto if bytes.starts_with(PNG_MAGIC) => {}
        PixelFormat::Png => {}
        PixelFormat::Depth16 | PixelFormat::Auto => {
            return fit::depth(bytes.to_vec(), raw_size(bytes, 2, sizes)?, sizes);
        }
    }
    let image = decode(bytes, ImageFormat::Png, sizes)?;
    let found = (image.height(), image.width());
    if let DynamicImage::ImageLuma16(image) = image {
        return fit::depth(image.into_raw().into_iter().flat_map(u16::to_le_bytes).collect(), found, sizes);
    }
    let found = image.color();
    Err(broken(format!("the depth PNG has {found:?} pixels; save it as 16-bit gray in millimetres")))
}

/// The PNG of a depth image in the compression of ROS; other bytes are unchanged.
pub(crate) fn without_ros_prefix(bytes: &[u8]) -> &[u8] {
    bytes.get(ROS_DEPTH_PREFIX..).filter(|inner| inner.starts_with(PNG_MAGIC)).unwrap_or(bytes)
}

/// Encodes height × width × 3 bytes of RGB as JPEG of this quality (1 to 100).
///
/// # Errors
/// [`RecordingError::BrokenImage`] if the bytes are not of that size.
pub fn encode_jpeg(rgb: &[u8], height: u32, width: u32, quality: u8) -> Result<Vec<u8>, RecordingError> {
    let rgb = exact(rgb, pixels(height, width)?.saturating_mul(3), "8-bit RGB")?;
    let mut out = Vec::new();
    JpegEncoder::new_with_quality(&mut out, quality.clamp(1, 100))
        .encode(rgb, width, height, ExtendedColorType::Rgb8)
        .map_err(|error| broken(error.to_string()))?;
    Ok(out)
}

/// Encodes height × width × 3 bytes of RGB as PNG, without loss.
///
/// # Errors
/// [`RecordingError::BrokenImage`] if the bytes are not of that size.
pub fn encode_png(rgb: &[u8], height: u32, width: u32) -> Result<Vec<u8>, RecordingError> {
    let rgb = exact(rgb, pixels(height, width)?.saturating_mul(3), "8-bit RGB")?;
    png(rgb, (height, width), ExtendedColorType::Rgb8)
}

/// Encodes height × width 16-bit little-endian millimetres as a PNG of 16-bit gray.
///
/// # Errors
/// [`RecordingError::BrokenImage`] if the bytes are not of that size.
pub fn encode_depth_png(millimetres: &[u8], height: u32, width: u32) -> Result<Vec<u8>, RecordingError> {
    let depth = exact(millimetres, pixels(height, width)?.saturating_mul(2), "16-bit depth")?;
    let native: Vec<u8> =
        depth.chunks_exact(2).flat_map(|pixel| u16::from_le_bytes([pixel[0], pixel[1]]).to_ne_bytes()).collect();
    png(&native, (height, width), ExtendedColorType::L16)
}

fn png(pixels: &[u8], (height, width): (u32, u32), color: ExtendedColorType) -> Result<Vec<u8>, RecordingError> {
    let mut out = Vec::new();
    let encoder = PngEncoder::new_with_quality(&mut out, CompressionType::Default, FilterType::Adaptive);
    encoder.write_image(pixels, width, height, color).map_err(|error| broken(error.to_string()))?;
    Ok(out)
}

/// Whether the bytes are a whole JPEG of three colors in this (height, width).
pub(crate) fn is_color_jpeg(bytes: &[u8], (height, width): (u32, u32)) -> bool {
    if codec_of(bytes) != Some(ImageFormat::Jpeg) || !is_whole_jpeg(bytes) {
        return false;
    }
    let decoder = ImageReader::with_format(Cursor::new(bytes), ImageFormat::Jpeg).into_decoder();
    decoder.is_ok_and(|decoder| {
        decoder.dimensions() == (width, height) && decoder.original_color_type() == ExtendedColorType::Rgb8
    })
}

/// Whether a JPEG has a closing marker. One in a segment before the pixels is that of a thumbnail.
fn is_whole_jpeg(bytes: &[u8]) -> bool {
    const SCAN: u8 = 0xda;
    let mut rest = bytes.get(2..).unwrap_or_default();
    while let [0xff, marker, high, low, ..] = rest
        && *marker != SCAN
    {
        let skipped = match marker {
            // Padding, and markers without a length.
            0xff => 1,
            0x01 | 0xd0..=0xd9 => 2,
            _ => 2 + usize::from(u16::from_be_bytes([*high, *low])),
        };
        rest = rest.get(skipped..).unwrap_or_default();
    }
    rest.windows(2).rev().any(|marker| marker == [0xff, 0xd9])
}

/// The compression that the first bytes show.
fn codec_of(bytes: &[u8]) -> Option<ImageFormat> {
    match bytes {
        [0xff, 0xd8, 0xff, ..] => Some(ImageFormat::Jpeg),
        [b'R', b'I', b'F', b'F', _, _, _, _, b'W', b'E', b'B', b'P', ..] => Some(ImageFormat::WebP),
        _ if bytes.starts_with(PNG_MAGIC) => Some(ImageFormat::Png),
        _ => None,
    }
}

/// Name of the compression that the first bytes show, such as `jpeg`.
pub(crate) fn codec_name(bytes: &[u8]) -> Option<&'static str> {
    codec_of(bytes)?.to_mime_type().strip_prefix("image/")
}

/// What the header of a compressed image shows.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Header {
    /// Name of the compression.
    pub(crate) codec: &'static str,
    /// (height, width).
    pub(crate) size: (u32, u32),
    /// Whether it is a depth image: 16-bit gray.
    pub(crate) depth: bool,
}

/// Reads the header of a compressed image of any size.
///
/// # Errors
/// [`RecordingError::BrokenImage`].
pub(crate) fn header_of(bytes: &[u8]) -> Result<Header, RecordingError> {
    let bytes = without_ros_prefix(bytes);
    let found = codec_of(bytes).zip(codec_name(bytes));
    let (format, codec) = found.ok_or_else(|| {
        broken(format!("{} bytes are neither JPEG, PNG nor WebP; record one of these or a raw image", bytes.len()))
    })?;
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    let mut limits = Limits::default();
    limits.max_alloc = Some(BYTES_ASIDE);
    reader.limits(limits);
    let decoder = reader.into_decoder().map_err(|error| broken(error.to_string()))?;
    let (width, height) = decoder.dimensions();
    let depth = format == ImageFormat::Png && decoder.color_type() == ColorType::L16;
    Ok(Header { codec, size: (height, width), depth })
}

/// Checks the size in the header first, so that a false size reserves no memory.
fn decode(bytes: &[u8], codec: ImageFormat, sizes: &PictureSizes) -> Result<DynamicImage, RecordingError> {
    let fixable = |error: image::ImageError| broken(format!("{error}; record it again or as JPEG or PNG"));
    // The decoder silently fills the missing part of a truncated JPEG with gray.
    if codec == ImageFormat::Jpeg && !is_whole_jpeg(bytes) {
        return Err(broken("the JPEG ends in the middle; record it again"));
    }
    let mut reader = ImageReader::with_format(Cursor::new(bytes), codec);
    let mut limits = Limits::default();
    let pixels = [sizes.recorded(), sizes.step()].map(|(height, width)| u64::from(height) * u64::from(width));
    let pixels = pixels[0].max(pixels[1]);
    limits.max_alloc = Some(pixels.saturating_mul(BYTES_PER_PIXEL).saturating_add(BYTES_ASIDE));
    reader.limits(limits);
    let decoder = reader.into_decoder().map_err(fixable)?;
    let (found_width, found_height) = decoder.dimensions();
    fit::check_size(sizes, (found_height, found_width))?;
    DynamicImage::from_decoder(decoder).map_err(fixable)
}

/// The (height, width) of raw pixels: the recorded one or that of a step, whichever has as many bytes.
pub(crate) fn raw_size(bytes: &[u8], pixel_bytes: u64, sizes: &PictureSizes) -> Result<(u32, u32), RecordingError> {
    let length = |(height, width): (u32, u32)| (u64::from(height) * u64::from(width)).saturating_mul(pixel_bytes);
    let found = u64::try_from(bytes.len()).unwrap_or(u64::MAX);
    let fits = [sizes.recorded(), sizes.step()].into_iter().find(|size| length(*size) == found);
    fits.ok_or_else(|| {
        let what = if pixel_bytes == 3 { "8-bit RGB" } else { "16-bit depth" };
        broken(format!(
            "{found} bytes are neither JPEG, PNG nor WebP, and {what} of this size has {}; send one of these",
            length(sizes.recorded())
        ))
    })
}

fn exact<'a>(bytes: &'a [u8], length: usize, what: &str) -> Result<&'a [u8], RecordingError> {
    if bytes.len() == length {
        return Ok(bytes);
    }
    Err(broken(format!(
        "{} bytes are neither JPEG, PNG nor WebP, and {what} of this size has {length}; send one of these",
        bytes.len()
    )))
}

fn pixels(height: u32, width: u32) -> Result<usize, RecordingError> {
    usize::try_from(u64::from(height) * u64::from(width)).map_err(|_| broken("the image is too large for this machine"))
}

fn broken(problem: impl Into<String>) -> RecordingError {
    RecordingError::BrokenImage { problem: problem.into() }
}

#[cfg(test)]
mod tests;
