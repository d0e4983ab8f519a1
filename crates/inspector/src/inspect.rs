//! From a recording to a verdict.
//!
//! Nothing here may be trusted to return: hostile bytes can abort this process, and that is what it is for.

use gleaner_recording::{RecordingError, Report, TaskSpec, read_episode_within, salvage};

use crate::{InspectError, Order, limits};

/// What is said of a recording.
#[derive(Debug, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
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
pub fn inspect(order: &Order) -> Result<(), InspectError> {
    limits::take(order)?;
    let verdict = match read(order)? {
        Ok(verdict) => verdict,
        Err(error @ (RecordingError::Io { .. } | RecordingError::Write(_))) => Verdict::Fault(error.to_string()),
        Err(error) => Verdict::Refused(error.to_string()),
    };
    let json = serde_json::to_vec(&verdict).map_err(InspectError::when("writing the verdict"))?;
    std::fs::write(&order.report, json).map_err(InspectError::when("writing the verdict"))
}

fn read(order: &Order) -> Result<Result<Verdict, RecordingError>, InspectError> {
    if let Some(out) = &order.salvage {
        return Ok(salvage(&order.recording, out).map(Verdict::Salvaged));
    }
    let spec = spec(order)?;
    let read = read_episode_within(&order.recording, &spec, &order.limits.limits());
    Ok(read.and_then(|reading| reading.episode.write_cache(&order.frames).map(|()| Verdict::Usable(reading.report))))
}

fn spec(order: &Order) -> Result<TaskSpec, InspectError> {
    let spec = std::fs::read(&order.spec).map_err(InspectError::when("reading the spec"))?;
    serde_json::from_slice(&spec).map_err(InspectError::when("reading the spec"))
}
