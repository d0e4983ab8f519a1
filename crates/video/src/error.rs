//! Why a message has no picture.

use std::fmt::Display;

/// The reason why a message has no picture.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum VideoError {
    /// The stream's pictures do not have the size of the camera.
    #[error("the video has {found_height}×{found_width} pixels (height×width), not {height}×{width}")]
    WrongSize {
        /// Height expected.
        height: u32,
        /// Width expected.
        width: u32,
        /// Height found.
        found_height: u32,
        /// Width found.
        found_width: u32,
    },
    /// The stream is valid but of a kind that is not decoded.
    #[error("{0}")]
    Unsupported(String),
    /// The bytes are damaged, or pictures before them are missing.
    #[error("{0}")]
    Damaged(String),
    /// The picture depends on one that is damaged or missing.
    #[error("it depends on a damaged or missing picture; pictures resume at the next key frame")]
    Lost,
    /// No key frame came before the picture.
    #[error("it comes before the first key frame")]
    BeforeKey,
}

impl VideoError {
    pub(crate) fn damaged(problem: impl Into<String>) -> Self {
        Self::Damaged(problem.into())
    }

    /// Each picture is one field of an interlaced frame; the filter of FFmpeg makes progressive frames of them.
    pub(crate) fn fields(codec: impl Display, filter: &str) -> Self {
        Self::Unsupported(format!(
            "{codec} with field pictures (interlaced video) is not decoded; record progressive video or convert: \
             ffmpeg -i in.mp4 -vf {filter} -c:v libx264 -pix_fmt yuv420p -bf 0 -g 30 out.h264"
        ))
    }

    /// Whether later messages can have pictures nevertheless.
    pub fn passes(&self) -> bool {
        match self {
            Self::Damaged(_) | Self::Lost | Self::BeforeKey => true,
            Self::WrongSize { .. } | Self::Unsupported(_) => false,
        }
    }
}
