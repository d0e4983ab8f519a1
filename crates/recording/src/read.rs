//! From a recording to an episode and its report: the plan of the steps, then the pixels.

use std::path::Path;

use crate::error::RecordingError;
use crate::fill::fill;
use crate::frames::Episode;
use crate::limits::Limits;
use crate::planner::plan;
use crate::validate::validate_within;
use gleaner_core::Report;
use gleaner_core::TaskSpec;

/// A recording that was read.
#[derive(Clone, Debug)]
pub struct Reading {
    /// The aligned steps.
    pub episode: Episode,
    /// The findings.
    pub report: Report,
    /// Name of the mapping that was used.
    pub mapping: String,
}

/// Reads a recording as an episode of this task.
///
/// # Errors
/// [`RecordingError::Rejected`] with the whole report if a finding forbids the use; the other variants are the reasons why
/// the file cannot be read.
pub fn read_episode(path: &Path, spec: &TaskSpec) -> Result<Reading, RecordingError> {
    read_episode_within(path, spec, &Limits::default())
}

/// Like [`read_episode`], with other limits than the default.
///
/// # Errors
/// Like [`read_episode`].
pub fn read_episode_within(path: &Path, spec: &TaskSpec, limits: &Limits) -> Result<Reading, RecordingError> {
    validate_within(spec, limits)?;
    let mut plan = plan(path, spec, limits)?;
    let frames = fill(path, spec, limits, &mut plan)?;
    let report = std::mem::take(&mut plan.report).sorted();
    if report.has_errors() {
        return Err(RecordingError::Rejected(Box::new(report)));
    }
    let episode = Episode::new(spec, plan.stamps, plan.proprioception, plan.action, frames)?;
    Ok(Reading { episode, mapping: report.mapping.clone(), report })
}
