//! What a dataset holds, and what its recordings look like. Must not know a format.

use gleaner_core::{Alignment, TaskSpec, ValueRange};
use serde::{Deserialize, Serialize};

/// What a dataset holds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Description {
    /// The format with its version, such as `LeRobot v3.0`.
    pub format: String,
    /// Number of episodes.
    pub episodes: u64,
    /// Number of steps of all episodes.
    pub steps: u64,
    /// Whether the dataset states its rate; else the rate of the task is a guess.
    pub rate_stated: bool,
    /// The name of the environment, if the dataset states one; it may have any characters.
    #[serde(default)]
    pub environment: Option<String>,
    /// A task that its recordings fit, with pictures of the recorded size. Its name is the same for every dataset.
    pub spec: TaskSpec,
    /// Where each field of the task comes from: those of the proprioception, then those of the action.
    pub fields: Vec<FieldOrigin>,
    /// Where each camera of the task comes from, in words.
    pub cameras: Vec<String>,
    /// What is in no recording.
    pub left_out: Vec<LeftOut>,
}

/// A task of this rate, to which an import adds the dataset's cameras and fields.
pub(super) fn empty_task(rate_hz: f64) -> TaskSpec {
    TaskSpec {
        name: "dataset".to_owned(),
        instruction: String::new(),
        openpi: Vec::new(),
        rate_hz,
        cameras: Vec::new(),
        proprioception: Vec::new(),
        action: Vec::new(),
        alignment: Alignment::default(),
        tolerance: 0.25,
        mappings: Vec::new(),
    }
}

/// Where a field comes from.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FieldOrigin {
    /// The feature of the dataset.
    pub feature: String,
    /// The dataset's names of its values; empty if it has none.
    pub names: Vec<String>,
    /// The range of its values in the whole dataset, if that is stated.
    pub range: Option<ValueRange>,
    /// Its values if there are at most two, in rising order; empty if there are more or it is not stated.
    #[serde(default)]
    pub values: Vec<f64>,
}

/// A part of a dataset that is in no recording.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LeftOut {
    /// The part.
    pub what: String,
    /// The reason.
    pub reason: String,
}

/// An episode that was converted.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Converted {
    /// Number of steps.
    pub steps: u64,
    /// Whether it succeeded, if the dataset states it.
    pub success: Option<bool>,
}

impl Description {
    /// Adds what a recording leaves out.
    pub(super) fn leave_out(&mut self, what: impl Into<String>, reason: &str) {
        self.left_out.push(LeftOut { what: what.into(), reason: reason.to_owned() });
    }
}
