//! The crate's one error type. Must not know what callers do with it.

use std::path::PathBuf;

use gleaner_recording::RecordingError;

/// What can go wrong in the simulator's dealings with its caller or with files. Simulating itself cannot fail.
#[derive(Debug, thiserror::Error)]
pub enum SimError {
    /// A task name that is not known.
    #[error("task: {0:?} is not known; use one of {names}", names = crate::Task::ALL.map(crate::Task::name).join(", "))]
    UnknownTask(String),
    /// A task specification that is not a simulated task's.
    #[error("task.{field}: {given} cannot be simulated as {task}; it needs {wanted}")]
    Incompatible {
        /// The simulated task.
        task: crate::Task,
        /// The specification's field.
        field: &'static str,
        /// What it says.
        given: String,
        /// What it would have to say.
        wanted: String,
    },
    /// A cohort of a set without a usable name.
    #[error("cohort: {name:?}: {detail}")]
    Cohort {
        /// The name as given.
        name: String,
        /// What is wrong with it and the mend.
        detail: &'static str,
    },
    /// An agent description that cannot be read.
    #[error("agent: {text:?}: {detail}")]
    Agent {
        /// The text as given.
        text: String,
        /// What is wrong with it and the mend.
        detail: String,
    },
    /// A setting outside its range.
    #[error("config.{field}: {detail}")]
    Config {
        /// The setting.
        field: &'static str,
        /// What is wrong with it and the mend.
        detail: String,
    },
    /// A recording could not be written.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// A file or folder could not be written.
    #[error("cannot write {path}: {source}")]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
    /// A table could not be written.
    #[error("cannot write {path}: {source}")]
    Table {
        /// The table's file.
        path: PathBuf,
        /// The cause.
        source: csv::Error,
    },
}
