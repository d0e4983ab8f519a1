//! Codecs of cameras.

use serde::Serialize;

/// The form in which a camera's pictures are recorded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Codec {
    /// One JPEG for each picture.
    Jpeg,
    /// H.264 video.
    H264,
    /// H.265 video.
    H265,
    /// AV1 video.
    Av1,
}

impl Codec {
    /// Every codec with its word.
    pub(crate) const ALL: [(&'static str, Self); 4] =
        [("jpeg", Self::Jpeg), ("h264", Self::H264), ("h265", Self::H265), ("av1", Self::Av1)];
}
