//! The error type of the crate.

use std::path::PathBuf;

use gleaner_recording::RecordingError;

/// Errors of arguments and of files. The simulation itself cannot fail.
#[derive(Debug, thiserror::Error)]
pub enum SimError {
    /// An unknown task name.
    #[error("task: {given:?} is unknown; use one of {}", known.join(", "))]
    UnknownTask {
        /// The name as given.
        given: String,
        /// The names of all simulated tasks.
        known: Vec<&'static str>,
    },
    /// A task specification that differs from the simulated task.
    #[error("task.{field}: {given} cannot be simulated as {task}; it needs {wanted}")]
    Incompatible {
        /// The simulated task.
        task: &'static str,
        /// The specification's field.
        field: &'static str,
        /// Its value.
        given: String,
        /// The value that the simulated task requires.
        wanted: String,
    },
    /// A cohort with an invalid name.
    #[error("cohort: {name:?}: {detail}")]
    Cohort {
        /// The name as given.
        name: String,
        /// The reason and the fix.
        detail: &'static str,
    },
    /// An invalid description of an agent.
    #[error("agent: {text:?}: {detail}")]
    Agent {
        /// The text as given.
        text: String,
        /// The reason and the fix.
        detail: String,
    },
    /// A setting outside its range.
    #[error("config.{field}: {detail}")]
    Config {
        /// The setting.
        field: &'static str,
        /// The reason and the fix.
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
