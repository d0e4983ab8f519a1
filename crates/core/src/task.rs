//! Tasks: a named skill with its specification.

use crate::TaskSpec;

use super::{id::TaskId, time::Millis};

/// A named robot skill, and how its steps are found in a recording.
#[derive(Debug, Clone)]
pub struct Task {
    /// Its id.
    pub id: TaskId,
    /// The contents of a step, and their location in recordings. Immutable.
    pub spec: TaskSpec,
    /// When it was created.
    pub created_at: Millis,
}

/// Number of a task's episodes by outcome.
#[derive(Debug, Clone, Copy, Default)]
pub struct OutcomeCounts {
    /// Labelled success.
    pub success: u64,
    /// Labelled failure.
    pub failure: u64,
    /// Labelled unknown.
    pub unknown: u64,
}
