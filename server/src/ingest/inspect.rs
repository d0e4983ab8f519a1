//! What runs inside the inspecting child: take limits, read the recording, write the verdict and the frames.
//!
//! Nothing here may be trusted to return: hostile bytes can abort this process, and that is what it is for.

use gleaner_recording::{RecordingError, Report, TaskSpec, read_episode_within, salvage};

use super::limits;
use crate::{
    config::InspectConfig,
    error::{Error, Result},
};

/// What the child tells its parent.
#[derive(Debug, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Verdict {
    /// The task can use the recording; its frames are written.
    Usable(Report),
    /// What is whole of it was copied, with so many actions.
    Salvaged(u64),
    /// It cannot; why, and the mend.
    Refused(String),
    /// Not the recording's fault.
    Fault(String),
}

/// Inspects, or salvages, one recording under limits that this process takes upon itself. It is Ok once a verdict is
/// written, whatever the verdict.
///
/// # Errors
/// When the limits, the spec or the verdict's file cannot be used.
pub fn inspect(config: &InspectConfig) -> Result<()> {
    limits::take(config)?;
    judge(config)
}

/// Reads the recording and writes the verdict.
fn judge(config: &InspectConfig) -> Result<()> {
    let read = match &config.salvage {
        Some(out) => salvage(&config.recording, out).map(Verdict::Salvaged),
        None => {
            let spec = spec(config)?;
            read_episode_within(&config.recording, &spec, &config.limits.limits()).and_then(|reading| {
                reading.episode.write_cache(&config.frames).map(|()| Verdict::Usable(reading.report))
            })
        }
    };
    let verdict = match read {
        Ok(verdict) => verdict,
        Err(error @ (RecordingError::Io { .. } | RecordingError::Write(_))) => Verdict::Fault(error.to_string()),
        Err(error) => Verdict::Refused(error.to_string()),
    };
    let json = serde_json::to_vec(&verdict).map_err(|error| Error::internal("writing the verdict", error))?;
    std::fs::write(&config.report, json).map_err(|error| Error::internal("writing the verdict", error))
}

fn spec(config: &InspectConfig) -> Result<TaskSpec> {
    let spec = std::fs::read(&config.spec).map_err(|error| Error::internal("reading the spec", error))?;
    serde_json::from_slice(&spec).map_err(|error| Error::internal("reading the spec", error))
}
