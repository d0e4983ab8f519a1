//! The codecs, and the names that recorders have for them.

use crate::error::VideoError;

/// A codec that is decoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Codec {
    /// H.264 (AVC), Annex B.
    H264,
    /// H.265 (HEVC), Annex B.
    H265,
    /// AV1, as a sequence of OBUs.
    Av1,
}

/// What a format's name stands for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Format {
    /// A video that is decoded.
    Video(Codec),
    /// A video of a codec that is not decoded; the error names it and the fix.
    Undecoded(VideoError),
    /// No video: a format of images, or unknown.
    Other,
}

/// Beginnings of the names of encoders and formats, in lower case.
const NAMES: [(&str, Codec); 12] = [
    ("h264", Codec::H264),
    ("h.264", Codec::H264),
    ("avc", Codec::H264),
    ("libx264", Codec::H264),
    ("h265", Codec::H265),
    ("h.265", Codec::H265),
    ("hevc", Codec::H265),
    ("libx265", Codec::H265),
    ("av1", Codec::Av1),
    ("libaom-av1", Codec::Av1),
    ("libsvtav1", Codec::Av1),
    ("librav1e", Codec::Av1),
];
const UNDECODED: [&str; 9] = ["vp8", "vp9", "libvpx", "mpeg", "h263", "vvc", "h266", "theora", "prores"];

impl Format {
    /// The meaning of a format's name, such as `h264`, `hevc_nvenc` or `libx264;yuv420p;bgr8`.
    pub fn named(name: &str) -> Self {
        let lower = name.trim().to_ascii_lowercase();
        if let Some((_, codec)) = NAMES.iter().find(|(begin, _)| lower.starts_with(begin)) {
            return Self::Video(*codec);
        }
        if UNDECODED.iter().any(|begin| lower.starts_with(begin)) {
            return Self::Undecoded(VideoError::Unsupported(format!(
                "video of the format `{name}` is not decoded; record or convert it as h264, h265 or av1"
            )));
        }
        Self::Other
    }
}

impl std::fmt::Display for Codec {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        out.write_str(match self {
            Self::H264 => "H.264",
            Self::H265 => "H.265",
            Self::Av1 => "AV1",
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn encoders_and_formats_name_their_codec() {
        for (name, codec) in [
            ("h264", Codec::H264),
            ("H264", Codec::H264),
            ("h264_nvenc;yuv420p;bgr8;bgr8", Codec::H264),
            ("libx264", Codec::H264),
            ("hevc", Codec::H265),
            ("h265", Codec::H265),
            ("av1", Codec::Av1),
            ("libsvtav1", Codec::Av1),
        ] {
            assert_eq!(Format::named(name), Format::Video(codec), "{name}");
        }
        for name in ["jpeg", "rgb8; jpeg compressed bgr8", "16UC1; compressedDepth png", ""] {
            assert_eq!(Format::named(name), Format::Other, "{name}");
        }
        let Format::Undecoded(error) = Format::named("vp9") else { panic!("vp9 is known") };
        assert!(error.to_string().contains("`vp9`") && error.to_string().contains("h264"), "{error}");
    }
}
