//! Copies the original messages of kept stretches of a recording into a file of their own.

use std::path::Path;

use crate::error::RecordingError;
use crate::spec::TaskSpec;

/// A stretch of steps to keep.
#[derive(Clone, Debug, PartialEq)]
pub struct Kept {
    /// First step of the stretch.
    pub first_step: u64,
    /// Last step of the stretch, inclusive.
    pub last_step: u64,
    /// q of each step of the stretch.
    pub quality: Vec<f32>,
    /// w of each step of the stretch.
    pub weight: Vec<f32>,
}

/// Writes one stretch of a recording to `out`: its original messages unchanged, the qualities as JSON on
/// `/gleaner/quality`, and a metadata record that names the source.
///
/// # Errors
/// As [`crate::read_episode`], and [`RecordingError::Step`] when the stretch is not in the episode.
pub fn extract(
    path: &Path,
    spec: &TaskSpec,
    kept: &Kept,
    out: &Path,
) -> Result<(), RecordingError> {
    let _ = (path, spec, kept, out);
    Err(RecordingError::Step {
        step: kept.first_step,
        problem: "not there yet".into(),
    })
}
