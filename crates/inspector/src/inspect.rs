//! The inspection: from a recording, or a dataset of another program, to a verdict.
//!
//! Hostile bytes can abort the process in any of these functions, which is why it is a separate process.

use std::io::Write as _;
use std::path::Path;
use std::time::{Duration, Instant};

use gleaner_formats::Problem;
use gleaner_formats::import::{self, Assumed, Converted, Description, Undescribed};
use gleaner_recording::{
    CutEpisode, Cuts, ImageThreads, Kept, RecordingError, Report, Survey, TaskSpec, TimeRange, cache_episode, cut,
    decoded_pixels, extract, salvage, summarize, survey,
};

use crate::{InspectError, Order, limits};

/// The part of an inspection's memory that messages and pictures under way may take is one over this.
const UNDER_WAY: u64 = 8;

/// Bytes of recordings after which a run of converted episodes ends: they lie on the disk until they are sent.
const RUN_BYTES: u64 = 64 << 20;
/// The part of an inspection's time after which it ends is one over this, so that no run is killed for its length.
const RUN_TIME: u64 = 4;

/// The result of an inspection.
#[derive(Debug, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// The task can use the recording; its frames are written.
    Usable(Report),
    /// The intact part was copied; it has this many actions.
    Salvaged(u64),
    /// What the recording holds.
    Surveyed(Survey),
    /// What a dataset of another program holds, or that the file is of another program.
    Described(Described),
    /// Episodes of a dataset of another program, the first of those ordered: each is written as a recording, or cannot be
    /// used, with the reason and the fix.
    Converted(Vec<Result<Converted, String>>),
    /// The recording is cut into these episodes.
    Cut(Vec<CutEpisode>),
    /// A copy of the recording with scores is written.
    Extracted,
    /// The recording is rejected, with the reason and the fix.
    Refused(String),
    /// The disk filled up.
    Full(String),
    /// The inspection failed for another reason outside the recording.
    Fault(String),
}

/// A path with data of another program.
#[derive(Debug, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Described {
    /// A dataset that can be converted.
    Dataset(Box<Description>),
    /// A sound file of a program whose data cannot be converted, with what it lacks.
    OtherProgram(String),
}

/// Inspects, salvages or surveys one recording under limits on this process. Any written verdict is a success.
///
/// # Errors
/// If a limit cannot be set, the spec cannot be read or the verdict cannot be written.
pub fn inspect(order: &Order) -> Result<(), InspectError> {
    limits::apply(order)?;
    let verdict = match read(order)? {
        Ok(verdict) => verdict,
        Err(error) if error.is_full() => Verdict::Full(error.to_string()),
        Err(error @ (RecordingError::Io { .. } | RecordingError::Write(_))) => Verdict::Fault(error.to_string()),
        Err(error) => Verdict::Refused(error.to_string()),
    };
    let json = serde_json::to_vec(&verdict).map_err(InspectError::when("writing the verdict"))?;
    std::fs::write(&order.report, json).map_err(InspectError::when("writing the verdict"))
}

fn read(order: &Order) -> Result<Result<Verdict, RecordingError>, InspectError> {
    let path = &order.recording;
    let assumed = Assumed { rate_hz: order.rate_hz, success_column: order.success_column.clone() };
    if order.describe {
        return Ok(match import::describe(path, &assumed) {
            Ok(description) => Ok(Verdict::Described(Described::Dataset(Box::new(description)))),
            Err(Undescribed::OtherProgram(lack)) => Ok(Verdict::Described(Described::OtherProgram(lack))),
            Err(Undescribed::Problem(problem)) => import_failure(problem),
        });
    }
    if let Some(episodes) = order.convert.clone() {
        let (begun, most) = (Instant::now(), Duration::from_secs(order.seconds / RUN_TIME));
        let enough = |bytes| bytes >= RUN_BYTES || begun.elapsed() >= most;
        let converted = import::convert_run(path, &assumed, episodes, &order.frames, enough);
        let each =
            |results: Vec<Result<_, Problem>>| results.into_iter().map(|result| result.map_err(reason)).collect();
        return Ok(converted.map(each).map(Verdict::Converted).or_else(import_failure));
    }
    if let Some(topic) = &order.cut {
        return Ok(cut(path, Cuts::Topic(topic), &order.limits.limits(), &order.frames).map(Verdict::Cut));
    }
    if let Some(ranges) = &order.cut_ranges {
        let ranges: Vec<TimeRange> = json(ranges, "reading the ranges")?;
        return Ok(cut(path, Cuts::Ranges(&ranges), &order.limits.limits(), &order.frames).map(Verdict::Cut));
    }
    if let Some(out) = &order.salvage {
        return Ok(salvage(&order.recording, out).map(Verdict::Salvaged));
    }
    if order.survey {
        let found = survey(&order.recording, &order.limits.limits(), order.pictures.as_deref());
        return Ok(found.map(Verdict::Surveyed));
    }
    let spec: TaskSpec = json(&order.spec, "reading the spec")?;
    if let Some(kept) = &order.extract {
        let kept: Kept = json(kept, "reading the scores")?;
        return Ok(extract(&order.recording, &spec, &kept, &order.frames).map(|()| Verdict::Extracted));
    }
    grant_time_for_pictures(order, &spec)?;
    let bytes = usize::try_from(order.memory_bytes / UNDER_WAY).unwrap_or(usize::MAX);
    let threads = ImageThreads { count: order.threads, bytes };
    let cached = cache_episode(&order.recording, &spec, (&order.limits.limits(), threads), &order.frames);
    Ok(cached.map(Verdict::Usable))
}

/// Extends the limit on processor time by that of the pictures that the recording states, and prints it for the parent.
fn grant_time_for_pictures(order: &Order, spec: &TaskSpec) -> Result<(), InspectError> {
    // A recording that states nothing about itself, or cannot be read, has the time of its size.
    let stated = summarize(&order.recording).ok().flatten();
    let seconds = order.seconds_for(stated.map_or(0, |summary| decoded_pixels(&summary, spec)));
    let seconds = limits::extend(order.seconds, seconds)?;
    // Without a parent that reads it, the line is of no use.
    let mut out = std::io::stdout();
    let _ = writeln!(out, "{seconds}").and_then(|()| out.flush());
    Ok(())
}

/// A dataset's own faults are a verdict; a failed file operation is the error of a recording.
fn import_failure(problem: Problem) -> Result<Verdict, RecordingError> {
    file_failure(problem).map(Verdict::Refused)
}

/// Why an episode cannot be used.
fn reason(problem: Problem) -> String {
    file_failure(problem).unwrap_or_else(|error| error.to_string())
}

/// The text of a dataset's own fault, or the error of a failed file operation.
fn file_failure(problem: Problem) -> Result<String, RecordingError> {
    match problem {
        Problem::Io { path, source } => Err(RecordingError::Io { path, source }),
        Problem::Recording { source: error, .. } if error.io_source().is_some() => Err(error),
        Problem::Recording { .. } | Problem::Unfit(_) | Problem::Input(_) => Ok(problem.to_string()),
    }
}

/// A file that the parent has written.
fn json<T: serde::de::DeserializeOwned>(path: &Path, when: &'static str) -> Result<T, InspectError> {
    let bytes = std::fs::read(path).map_err(InspectError::when(when))?;
    serde_json::from_slice(&bytes).map_err(InspectError::when(when))
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use gleaner_recording::EpisodeWriter;

    use super::*;

    #[test]
    fn a_disk_that_fills_while_an_episode_is_converted_is_no_fault_of_the_dataset() {
        let task: TaskSpec = serde_json::from_value(serde_json::json!({
            "name": "reach", "rate_hz": 10.0, "mappings": [], "cameras": [],
            "proprioception": [{ "name": "joints", "size": 2 }],
            "action": [{ "name": "command", "size": 1 }],
        }))
        .unwrap();
        let mut room = [0_u8; 16];
        let written = EpisodeWriter::create(Cursor::new(&mut room[..]), &task).and_then(EpisodeWriter::finish);
        let problem = |source| Problem::Recording { episode: "0".to_owned(), source };
        let error = file_failure(problem(written.err().unwrap())).unwrap_err();
        assert!(error.to_string().starts_with("writing MCAP failed"), "{error}");
        let empty = RecordingError::Empty { path: "a.mcap".into() };
        assert!(file_failure(problem(empty)).unwrap().contains("is empty"));
    }
}
