//! The recording of one episode as it is written: evenly clocked steps, and everything else of the dataset beside them.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use gleaner_core::TaskSpec;
use gleaner_recording::{CameraMessage, EpisodeWriter, RecordingError, written_mapping};
use serde_json::{Map, Value};

use crate::problem::Problem;

/// Time of the first step in nanoseconds: late enough for packets of video before it, on which its picture may depend.
const START: i64 = 1_000_000_000_000;
const SECOND: f64 = 1e9;
/// Topic of the dataset's other values, one JSON message a step.
const FRAME_TOPIC: &str = "/dataset/frame";
/// Name of the metadata record.
const METADATA: &str = "gleaner.dataset";

/// A recording that is being written.
pub(super) struct Recorder {
    writer: EpisodeWriter<BufWriter<File>>,
    out: PathBuf,
    /// For messages.
    episode: String,
    rate_hz: f64,
    steps: u64,
}

impl Recorder {
    /// Begins the recording. `episode`: its name, for errors.
    pub(super) fn create(out: &Path, episode: String, spec: &TaskSpec) -> Result<Self, Problem> {
        let file = File::create(out).map_err(Problem::io(out))?;
        let writer = EpisodeWriter::create(BufWriter::new(file), spec).map_err(Problem::recording(&episode))?;
        Ok(Self { writer, out: out.to_owned(), episode, rate_hz: spec.rate_hz, steps: 0 })
    }

    /// The stamp of a moment, in seconds from the first step on.
    pub(super) fn stamp(seconds: f64) -> i64 {
        #[expect(clippy::cast_possible_truncation, reason = "saturates; a stamp below zero is refused when written")]
        let nanoseconds = (seconds * SECOND).round() as i64;
        START.saturating_add(nanoseconds)
    }

    /// The stamp of a step.
    pub(super) fn step_stamp(&self, step: u64) -> i64 {
        #[expect(clippy::cast_precision_loss, reason = "an episode has few steps")]
        let seconds = step as f64 / self.rate_hz;
        Self::stamp(seconds)
    }

    /// Writes a message of a camera.
    pub(super) fn camera(&mut self, camera: usize, stamp: i64, message: CameraMessage<'_>) -> Result<(), Problem> {
        let written = self.writer.camera_message(camera, stamp, message);
        written.map_err(|error| self.problem(error))
    }

    /// Ends the next step: its numbers, and the dataset's other values.
    pub(super) fn step(&mut self, state: &[f32], action: &[f32], others: Map<String, Value>) -> Result<(), Problem> {
        let stamp = self.step_stamp(self.steps);
        let written = self.writer.sense(stamp, state).and_then(|()| {
            self.writer.annotate(FRAME_TOPIC, stamp, &Value::Object(others))?;
            self.writer.act(stamp, action)
        });
        self.steps += 1;
        written.map_err(|error| self.problem(error))
    }

    /// Writes what the dataset states of the whole episode.
    pub(super) fn metadata(&mut self, values: BTreeMap<String, String>) -> Result<(), Problem> {
        let written = self.writer.metadata(METADATA, values);
        written.map_err(|error| self.problem(error))
    }

    /// Ends the recording; returns the number of its steps.
    pub(super) fn finish(self) -> Result<u64, Problem> {
        let episode = self.episode;
        let file = self.writer.finish().map_err(Problem::recording(&episode))?;
        let file = file.into_inner().map_err(|error| Problem::io(&self.out)(error.into_error()))?;
        drop(file);
        Ok(self.steps)
    }

    fn problem(&self, error: RecordingError) -> Problem {
        let RecordingError::Step { problem, .. } = error else {
            return Problem::recording(&self.episode)(error);
        };
        Problem::Unfit(format!("episode {}, step {}: {problem}", self.episode, self.steps.saturating_sub(1)))
    }
}

/// The task with the mapping that reads its recordings.
pub(super) fn with_mapping(mut spec: TaskSpec) -> TaskSpec {
    spec.mappings = vec![written_mapping(&spec)];
    spec
}
