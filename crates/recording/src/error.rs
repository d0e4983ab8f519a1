//! Everything that can go wrong with a recording, each with what to do about it.

use std::path::PathBuf;

use gleaner_core::Report;

/// Why a recording, a task specification, an image or a frame cache can't be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RecordingError {
    /// The file system refused.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The task specification contradicts itself.
    #[error("task specification, {field}: {problem}")]
    Spec {
        /// Path of the field, such as `cameras[0].height`.
        field: String,
        /// What is wrong and the mend.
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
    /// The container is broken in a way that leaves its contents in doubt.
    #[error("damaged MCAP file: {problem}")]
    Damaged {
        /// What is wrong and the mend.
        problem: String,
    },
    /// A length or count is over a limit.
    #[error("too large: {problem}")]
    TooLarge {
        /// What is over which limit, and the mend.
        problem: String,
    },
    /// A field path does not lead to numbers in a message.
    #[error("topic {topic}, path {path}: {problem}")]
    Field {
        /// The topic.
        topic: String,
        /// The path as written in the mapping.
        path: String,
        /// What is wrong, which fields there are, and the mend.
        problem: String,
    },
    /// The recording was read and has findings of severity error: the report names each.
    #[error("the recording can't be used: {}", .0.error_summary())]
    Rejected(Box<Report>),
    /// An image is not of the size the task says.
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
        /// What is wrong and the mend.
        problem: String,
    },
    /// A frame cache is not one, is of another version, or is damaged.
    #[error("frame cache: {problem}; delete it, it is rebuilt from the recording")]
    Cache {
        /// What is wrong.
        problem: String,
    },
    /// A step handed to the writer does not fit the task.
    #[error("step {step}: {problem}")]
    Step {
        /// The step's number, from 0.
        step: u64,
        /// What is wrong and the mend.
        problem: String,
    },
    /// Writing an MCAP file failed.
    #[error("writing MCAP failed: {0}")]
    Write(mcap::McapError),
}
