//! Images inside messages: foxglove.CompressedImage and RawImage, sensor_msgs CompressedImage and Image.
//!
//! An image is recognised by its fields, so a lab's own message with the same fields works too. In JSON,
//! `data` is base64 text, as in Foxglove's JSON schemas, or an address that holds it, as browsers write pictures
//! (RFC 2397).

use std::borrow::Cow;

use base64::Engine as _;
use base64::alphabet::STANDARD;
use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};

use crate::dialect::Value;
use crate::error::RecordingError;
use crate::image::{
    CompressedDepth, Header, PixelFormat, RawImage, decode_color, decode_depth, header_of, raw_color, raw_depth,
};
use gleaner_core::CameraSpec;

/// The content of a camera's topic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Channel {
    Color,
    Depth,
}

impl Channel {
    /// Bytes of one image of a step.
    pub(crate) fn bytes(self, camera: &CameraSpec) -> usize {
        let pixels = (camera.height as usize).saturating_mul(camera.width as usize);
        match self {
            Self::Color => pixels.saturating_mul(3),
            Self::Depth => pixels.saturating_mul(2),
        }
    }
}

/// Decodes the image that a message holds to the pixels of a step.
pub(crate) fn decode(message: &Value<'_>, channel: Channel, camera: &CameraSpec) -> Result<Vec<u8>, RecordingError> {
    let sizes = &camera.sizes();
    let data = &*data(message)?;
    if let Some(encoding) = layout(message) {
        let size = |name| message.number(name).and_then(whole).ok_or_else(|| not_an_image(message));
        let image = RawImage {
            height: size("height")?,
            width: size("width")?,
            step: size("step")?,
            encoding,
            big_endian: message.number("is_bigendian").unwrap_or_default() != 0.0,
            data,
        };
        return match channel {
            Channel::Color => raw_color(image, sizes),
            Channel::Depth => raw_depth(image, sizes),
        };
    }
    let format = format(message).ok_or_else(|| not_an_image(message))?;
    // The compression is detected from the bytes where they show it, because drivers fill in any format.
    let decoded = match channel {
        Channel::Color => decode_color(data, PixelFormat::Auto, sizes),
        Channel::Depth => match CompressedDepth::of(format, data) {
            Some(compressed) => compressed.decode(data, sizes),
            None => decode_depth(data, PixelFormat::Auto, sizes),
        },
    };
    decoded.map_err(|mut error| {
        if let RecordingError::BrokenImage { problem } = &mut error {
            problem.insert_str(0, &format!("format `{format}`: "));
        }
        error
    })
}

/// What the header of a compressed image shows.
pub(crate) fn header(message: &Value<'_>) -> Result<Header, RecordingError> {
    let data = data(message)?;
    let compressed = format(message).and_then(|format| CompressedDepth::of(format, &data));
    compressed.map_or_else(|| header_of(&data), |compressed| compressed.header(&data))
}

/// The media type and the base64 text of `data:image/jpeg;base64,…` in `data`. It needs no other field.
pub(crate) fn address<'a>(message: &'a Value<'_>) -> Option<(&'a str, &'a str)> {
    let (media, text) = message.text("data")?.strip_prefix("data:")?.split_once(',')?;
    Some((media.strip_suffix(";base64").filter(|media| media.starts_with("image/"))?, text))
}

/// The layout of a raw image; an address holds a compressed one, whatever else the message states.
pub(crate) fn layout<'a>(message: &'a Value<'_>) -> Option<&'a str> {
    message.text("encoding").filter(|_| address(message).is_none())
}

fn format<'a>(message: &'a Value<'_>) -> Option<&'a str> {
    message.text("format").or_else(|| Some(address(message)?.0))
}

/// Base64 with or without padding: writers differ.
const BASE64: GeneralPurpose = GeneralPurpose::new(
    &STANDARD,
    GeneralPurposeConfig::new().with_decode_padding_mode(DecodePaddingMode::Indifferent),
);

/// The bytes of the image, which JSON holds as base64 text.
pub(crate) fn data<'a>(message: &'a Value<'_>) -> Result<Cow<'a, [u8]>, RecordingError> {
    if let Some(bytes) = message.bytes("data") {
        return Ok(Cow::Borrowed(bytes));
    }
    let text = match address(message) {
        Some((_, text)) => text,
        None => message.text("data").ok_or_else(|| not_an_image(message))?,
    };
    BASE64.decode(text).map(Cow::Owned).map_err(|error| RecordingError::BrokenImage {
        problem: format!("`data` is text but not base64 ({error}); JSON messages hold an image's bytes as base64"),
    })
}

/// A number as the side of an image; `None` for a fraction or one out of range.
pub(crate) fn whole(number: f64) -> Option<u32> {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "the range is checked first")]
    (number >= 0.0 && number <= f64::from(u32::MAX) && number.fract() == 0.0).then_some(number as u32)
}

fn not_an_image(message: &Value<'_>) -> RecordingError {
    RecordingError::BrokenImage {
        problem: format!(
            "the message has {}, which is no image; use foxglove.CompressedImage, foxglove.RawImage, \
             sensor_msgs/CompressedImage or sensor_msgs/Image; in JSON, `data` is base64 text or an address \
             `data:image/jpeg;base64,…`",
            message.field_names()
        ),
    }
}

#[cfg(test)]
mod tests {

    use super::*;

    fn camera() -> CameraSpec {
        CameraSpec { name: "c".into(), height: 1, width: 2, depth: true, recorded: None }
    }

    fn raw(encoding: &'static str, data: &'static [u8]) -> Value<'static> {
        Value::Message(vec![
            ("height".into(), Value::Number(1.0)),
            ("width".into(), Value::Number(2.0)),
            ("encoding".into(), Value::Text(encoding.into())),
            ("is_bigendian".into(), Value::Number(1.0)),
            ("step".into(), Value::Number(0.0)),
            ("data".into(), Value::Bytes(data.into())),
        ])
    }

    #[test]
    fn reads_raw_images_by_their_fields() {
        assert_eq!(decode(&raw("bgr8", &[3, 2, 1, 6, 5, 4]), Channel::Color, &camera()).unwrap(), [1, 2, 3, 4, 5, 6]);
        assert_eq!(decode(&raw("16UC1", &[1, 2, 3, 4]), Channel::Depth, &camera()).unwrap(), [2, 1, 4, 3]);
    }

    #[test]
    fn base64_text_is_bytes_with_or_without_padding() {
        for data in ["AwIBBgUE", "AwIBBgUEAA==", "AwIBBgUEAA"] {
            let Value::Message(mut fields) = raw("bgr8", &[]) else { unreachable!() };
            fields.pop();
            fields.push(("data".into(), Value::Text(data.into())));
            assert_eq!(
                decode(&Value::Message(fields), Channel::Color, &camera()).unwrap(),
                [1, 2, 3, 4, 5, 6],
                "{data}"
            );
        }
        let text = Value::Message(vec![
            ("format".into(), Value::Text("jpeg".into())),
            ("data".into(), Value::Text("not base64!".into())),
        ]);
        assert!(decode(&text, Channel::Color, &camera()).unwrap_err().to_string().contains("not base64"));
    }

    #[test]
    fn messages_without_an_image_are_rejected_by_name() {
        let video = Value::Message(vec![
            ("format".into(), Value::Text("h264".into())),
            ("data".into(), Value::Bytes(vec![0, 0, 0, 1].into())),
        ]);
        assert!(decode(&video, Channel::Color, &camera()).unwrap_err().to_string().contains("`h264`"));
        let other = Value::Message(vec![("position".into(), Value::Number(1.0))]);
        assert!(decode(&other, Channel::Color, &camera()).unwrap_err().to_string().contains("position"));
    }
}
