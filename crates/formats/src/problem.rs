//! Why an export cannot be written.

use std::path::{Path, PathBuf};

use gleaner_recording::RecordingError;

/// Why an export cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum Problem {
    /// A file of the export cannot be written.
    #[error("writing {}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The cause, such as a full disk.
        source: std::io::Error,
    },
    /// A recording cannot be read or copied.
    #[error("episode {episode}: {source}")]
    Recording {
        /// The episode.
        episode: String,
        /// The cause.
        source: RecordingError,
    },
    /// The dataset does not fit the format.
    #[error("{0}")]
    Unfit(String),
    /// The caller's input contradicts itself.
    #[error("{0}")]
    Input(String),
}

impl Problem {
    /// Wraps an error of a file, for `map_err`.
    pub(crate) fn io(path: &Path) -> impl Fn(std::io::Error) -> Self {
        move |source| Self::Io { path: path.to_path_buf(), source }
    }

    /// Wraps an error of a file's encoder, which has an IO error inside when the disk fails.
    pub(crate) fn encoding<E: std::error::Error + 'static>(path: &Path) -> impl Fn(E) -> Self {
        move |error| {
            let mut cause: Option<&(dyn std::error::Error + 'static)> = Some(&error);
            while let Some(this) = cause {
                if let Some(io) = this.downcast_ref::<std::io::Error>() {
                    let source = io.raw_os_error().map_or_else(
                        || std::io::Error::new(io.kind(), io.to_string()),
                        std::io::Error::from_raw_os_error,
                    );
                    return Self::Io { path: path.to_path_buf(), source };
                }
                cause = this.source();
            }
            Self::Io { path: path.to_path_buf(), source: std::io::Error::other(error.to_string()) }
        }
    }

    /// Wraps an error of a recording, for `map_err`.
    pub(crate) fn recording(episode: &str) -> impl Fn(RecordingError) -> Self {
        move |source| Self::Recording { episode: episode.to_owned(), source }
    }
}
