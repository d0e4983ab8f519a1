//! The survey of a recording: what it holds, read without a task.
//!
//! Plain data, for people who describe a task. This module does not depend on the reader.

use serde::{Deserialize, Serialize};

use crate::report::Finding;

/// What one recording holds.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub struct Survey {
    /// Profile of the file, such as `ros2`; empty without one.
    pub profile: String,
    /// Number of messages, of all topics.
    pub messages: u64,
    /// From the first to the last log time, in nanoseconds.
    pub duration_ns: i64,
    /// Every topic, by name.
    pub topics: Vec<SurveyedTopic>,
    /// Problems of the file, such as a missing end.
    pub findings: Vec<Finding>,
}

/// What one topic holds.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", default)]
pub struct SurveyedTopic {
    /// The topic.
    pub topic: String,
    /// Name of its schema; empty when it has none.
    pub schema: String,
    /// Message encoding, such as `protobuf` or `cdr`.
    pub encoding: String,
    /// Number of messages.
    pub messages: u64,
    /// Messages a second, by the median interval; 0 with fewer than two messages.
    pub rate_hz: f64,
    /// Whether each message has a stamp of its own; else log times are its times.
    pub stamped: bool,
    /// Intervals of more than 2.5 times the median one.
    pub gaps: u64,
    /// The longest interval, in nanoseconds.
    pub longest_interval_ns: i64,
    /// Why its first unreadable message, or its schema, cannot be read.
    pub problem: Option<String>,
    /// Number of messages that cannot be read.
    pub unreadable: u64,
    /// Its images, if it is the topic of a camera.
    pub camera: Option<SurveyedCamera>,
    /// The fields of its messages, in the order of the schema.
    pub fields: Vec<SurveyedField>,
    /// Whether it has more fields or values than are listed.
    pub more: bool,
}

/// The images of one topic.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", default)]
pub struct SurveyedCamera {
    /// Whether its pixels are distances.
    pub depth: bool,
    /// Compression or layout of the pixels, such as `jpeg`, `rgb8`, `16UC1` or `h264`.
    pub encoding: String,
    /// Height in pixels; 0 if no image can be read.
    pub height: u32,
    /// Width in pixels.
    pub width: u32,
    /// Number of images of another size.
    pub other_sizes: u64,
    /// Why its first unreadable image cannot be read.
    pub problem: Option<String>,
    /// Number of images that cannot be read.
    pub unreadable: u64,
    /// Name of the file with its first picture, if pictures are written.
    pub picture: Option<String>,
}

/// The values of one field of a message.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", default)]
pub struct SurveyedField {
    /// The path to it, as in the mapping of a task: `pose.position.x`.
    pub path: String,
    /// What it holds.
    pub kind: FieldKind,
    /// Number of messages that have it.
    pub messages: u64,
    /// The fewest values, or bytes of text, in a message.
    pub shortest: u64,
    /// The most values, or bytes of text, in a message.
    pub longest: u64,
    /// The range of each value of numbers; empty where their count varies. With names, in the order of `names`.
    pub ranges: Vec<ValueRange>,
    /// The different values of all numbers together, if there are at most two.
    pub values: Vec<f64>,
    /// Number of values that are NaN or infinite.
    pub not_finite: u64,
    /// The names in the `name` array beside it, such as those of joints, each once.
    pub names: Vec<String>,
    /// The beginning of the first text.
    pub text: String,
}

/// What a field holds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FieldKind {
    /// One number a message.
    #[default]
    Number,
    /// An array of numbers.
    Numbers,
    /// Text, or a list of texts.
    Text,
    /// Bytes.
    Bytes,
    /// A list that no path reads, such as rows of a matrix.
    Other,
}

/// The least and the greatest of some values.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub struct ValueRange {
    /// The least value.
    pub minimum: f64,
    /// The greatest value.
    pub maximum: f64,
}

impl ValueRange {
    /// The range of one value.
    pub fn of(value: f64) -> Self {
        Self { minimum: value, maximum: value }
    }

    /// The range that includes another one.
    #[must_use]
    pub fn with(self, other: Self) -> Self {
        Self { minimum: self.minimum.min(other.minimum), maximum: self.maximum.max(other.maximum) }
    }
}

impl SurveyedField {
    /// Whether each message has the same number of values.
    pub fn is_fixed(&self) -> bool {
        self.shortest == self.longest || !self.names.is_empty()
    }
}
