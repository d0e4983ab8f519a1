//! Why a film cannot be written.

/// Why a film cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum FilmError {
    /// The encoder takes no pictures of this size or rate.
    #[error("video of {height}×{width} pixels at {fps} Hz cannot be encoded ({problem}); export images instead")]
    Unfit {
        /// Height of a picture.
        height: u32,
        /// Width of a picture.
        width: u32,
        /// Pictures per second.
        fps: u32,
        /// The reason.
        problem: String,
    },
    /// A picture has another size than the film.
    #[error("a picture has {found} bytes, and one of this film has {expected}")]
    Picture {
        /// Bytes of the picture.
        found: usize,
        /// Bytes of a picture of the film.
        expected: usize,
    },
    /// The encoder failed.
    #[error("encoding a picture: {0}")]
    Encoder(String),
    /// The file cannot be written.
    #[error(transparent)]
    Io(#[from] std::io::Error),
}
