//! The error type of the crate; each error has its fix.

use std::path::PathBuf;

use gleaner_core::Report;

/// Why a recording, a task specification, an image or a frame cache can't be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RecordingError {
    /// A failed file operation.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
    /// The task specification contradicts itself.
    #[error("task specification, {field}: {problem}")]
    Spec {
        /// Path of the field, such as `cameras[0].height`.
        field: String,
        /// The reason and the fix.
        problem: String,
    },
    /// The file has no bytes.
    #[error("{} is empty; record the episode again or upload the right file", path.display())]
    Empty {
        /// The file.
        path: PathBuf,
    },
    /// The file is something else.
    #[error("{} is not an MCAP file (it does not begin with the MCAP magic bytes); convert it to MCAP first", path.display())]
    NotMcap {
        /// The file.
        path: PathBuf,
    },
    /// The container is damaged, so that its contents are doubtful.
    #[error("damaged MCAP file: {problem}")]
    Damaged {
        /// The reason and the fix.
        problem: String,
    },
    /// A length or count is over a limit.
    #[error("too large: {problem}")]
    TooLarge {
        /// The size, the limit and the fix.
        problem: String,
    },
    /// A field path does not lead to numbers in a message.
    #[error("topic {topic}, path {path}: {problem}")]
    Field {
        /// The topic.
        topic: String,
        /// The path as written in the mapping.
        path: String,
        /// The reason, the existing fields and the fix.
        problem: String,
    },
    /// The recording was read and has findings of severity error: the report names each.
    #[error("the recording cannot be used: {}", .0.error_summary())]
    Rejected(Box<Report>),
    /// An image does not have the size of the task.
    #[error(
        "image is {found_height}×{found_width} (height×width), the task expects {height}×{width}; record at that size or change the camera in the task"
    )]
    WrongSize {
        /// Height that the task expects.
        height: u32,
        /// Width that the task expects.
        width: u32,
        /// Height found.
        found_height: u32,
        /// Width found.
        found_width: u32,
    },
    /// An image can't be decoded or encoded.
    #[error("broken image: {problem}")]
    BrokenImage {
        /// The reason and the fix.
        problem: String,
    },
    /// A frame cache is not one, is of another version, or is damaged.
    #[error("frame cache: {problem}; delete it, it is rebuilt from the recording")]
    Cache {
        /// The reason.
        problem: String,
    },
    /// A recording cannot be cut by these ranges of time.
    #[error("{problem}")]
    Ranges {
        /// The range, the reason and the fix.
        problem: String,
    },
    /// A part of a recording cannot be joined with the others.
    #[error("{}: {problem}", path.display())]
    Part {
        /// The part.
        path: PathBuf,
        /// The reason and the fix.
        problem: String,
    },
    /// A step for the writer does not fit the task.
    #[error("step {step}: {problem}")]
    Step {
        /// The step's number, from 0.
        step: u64,
        /// The reason and the fix.
        problem: String,
    },
    /// Writing an MCAP file failed.
    #[error("writing MCAP failed: {}", cause(.0))]
    Write(#[source] mcap::McapError),
}

/// The message of an error of the MCAP writer, which does not name the cause of a failed file operation.
fn cause(error: &mcap::McapError) -> &dyn std::fmt::Display {
    if let mcap::McapError::Io(source) = error { source } else { error }
}

impl RecordingError {
    /// Whether a reader of a frame cache can continue once the cache is made again from its recording: the file is gone,
    /// damaged or of another version.
    pub fn is_of_the_cache(&self) -> bool {
        let gone = |source: &std::io::Error| source.kind() == std::io::ErrorKind::NotFound;
        matches!(self, Self::Cache { .. }) || matches!(self, Self::Io { source, .. } if gone(source))
    }

    /// The failed file operation, such as a write to a full disk; `None` if the cause is another one.
    pub fn io_source(&self) -> Option<&std::io::Error> {
        if let Self::Io { source, .. } | Self::Write(mcap::McapError::Io(source)) = self { Some(source) } else { None }
    }

    /// Whether a disk, or its owner's share of it, is full.
    pub fn is_full(&self) -> bool {
        use std::io::ErrorKind::{QuotaExceeded, StorageFull};
        self.io_source().is_some_and(|source| matches!(source.kind(), StorageFull | QuotaExceeded))
    }
}

#[cfg(test)]
mod tests {
    use std::io::{self, Seek, SeekFrom, Write};

    use super::*;
    use crate::EpisodeWriter;
    use crate::testing::arm;

    /// A disk without room.
    struct Full;

    impl Write for Full {
        fn write(&mut self, _: &[u8]) -> io::Result<usize> {
            Err(io::ErrorKind::StorageFull.into())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    impl Seek for Full {
        fn seek(&mut self, _: SeekFrom) -> io::Result<u64> {
            Ok(0)
        }
    }

    #[test]
    fn a_full_disk_is_known_wherever_a_recording_is_written() {
        let written = EpisodeWriter::create(Full, &arm()).and_then(EpisodeWriter::finish).err().unwrap();
        assert!(written.is_full(), "{written:?}");
        assert_eq!(
            written.to_string(),
            format!("writing MCAP failed: {}", io::Error::from(io::ErrorKind::StorageFull))
        );
        let path = PathBuf::from("a.mcap");
        let other = RecordingError::Io { path, source: io::ErrorKind::PermissionDenied.into() };
        assert!(other.io_source().is_some() && !other.is_full());
        assert!(RecordingError::Write(mcap::McapError::UnexpectedEof).io_source().is_none());
    }
}
