//! The report on a recording: counts, rates and findings, each with its fix.
//!
//! Plain data, which does not depend on how findings are made.

use serde::{Deserialize, Serialize};

/// The report on one recording.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", default)]
pub struct Report {
    /// Name of the mapping that was used; empty when none fits.
    pub mapping: String,
    /// Number of messages in the file, of all topics.
    pub messages: u64,
    /// Number of aligned steps.
    pub steps: u64,
    /// Time from the first to the last step, in nanoseconds.
    pub duration_ns: i64,
    /// Measured step rate in hertz; 0 with fewer than two steps.
    pub rate_hz: f64,
    /// Messages of the clock topic that were dropped: before every stream had begun, or faster than the rate.
    pub dropped_ticks: u64,
    /// Every topic of the file, by name.
    pub topics: Vec<TopicReport>,
    /// The findings, worst first.
    pub findings: Vec<Finding>,
}

/// One topic of a recording.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub struct TopicReport {
    /// The topic.
    pub topic: String,
    /// Name of its schema; empty when it has none.
    pub schema: String,
    /// Message encoding, such as `protobuf` or `cdr`.
    pub encoding: String,
    /// Number of messages.
    pub messages: u64,
    /// Whether the mapping reads it.
    pub used: bool,
}

/// A finding in a recording.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub struct Finding {
    /// Its severity.
    pub severity: Severity,
    /// Its kind.
    pub code: FindingCode,
    /// The subject: a topic, a field value such as `joint_position[3]`, or the file.
    pub subject: String,
    /// First step concerned, if it concerns single steps.
    pub first_step: Option<u64>,
    /// The reason and the fix.
    pub detail: String,
}

/// The severity of a finding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Severity {
    /// For information.
    Note,
    /// The episode can be used after a look at the finding.
    Warning,
    /// The episode is not usable.
    Error,
}

/// The kinds of findings.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum FindingCode {
    /// A topic that the mapping names is absent or has no messages.
    MissingTopic,
    /// A path of the mapping does not exist in a message.
    MissingField,
    /// A topic's schema or encoding is not supported.
    BadSchema,
    /// A message does not follow its schema.
    BadMessage,
    /// Two steps, or a step and its message, are more than 2.5 periods apart.
    Gap,
    /// A value is NaN or infinite.
    NotFinite,
    /// A joint's value stays the same while others move.
    FrozenJoint,
    /// An image or a field does not have the size of the task.
    WrongSize,
    /// The file ends in the middle; the whole messages before were read.
    Truncated,
    /// An image can't be decoded.
    BrokenImage,
    /// Stamps of a topic run backwards.
    TimeReversed,
    /// The measured step rate is far from the task's.
    OffRate,
    /// Fewer steps than an episode needs.
    TooShort,
    /// Header stamps are of different clocks, or of another one than log times.
    MixedClocks,
    /// A checksum of the file differs from its bytes.
    ChecksumMismatch,
    /// The statistics, an index or the footer contradict what was read.
    SummaryMismatch,
    /// Messages come before the channel record that declares them, or no channel record does.
    UndeclaredChannel,
    /// A schema or a channel is declared twice with different contents.
    ConflictingDeclaration,
    /// Bytes follow the end of the recording.
    TrailingBytes,
    /// A camera's images stay the same while the robot moves.
    FrozenCamera,
    /// Messages of video come before the first key frame.
    LateKeyFrame,
    /// The first step is more than 2.5 periods after the recording's first message of the clock.
    LateStart,
    /// A recorded action is beyond the limits of the task.
    OutsideLimits,
}

impl Report {
    /// Adds a finding, unless there is one of this kind on this subject already.
    pub fn add(
        &mut self,
        severity: Severity,
        code: FindingCode,
        subject: &str,
        first_step: Option<u64>,
        detail: String,
    ) {
        if self.findings.iter().any(|known| known.code == code && known.subject == subject) {
            return;
        }
        self.findings.push(Finding { severity, code, subject: subject.to_owned(), first_step, detail });
    }

    /// The worst findings first; findings of equal severity keep their order.
    pub fn sorted(mut self) -> Self {
        self.findings.sort_by_key(|finding| std::cmp::Reverse(finding.severity));
        self
    }

    /// Whether any finding makes the episode unusable.
    pub fn has_errors(&self) -> bool {
        self.findings.iter().any(|finding| finding.severity == Severity::Error)
    }

    /// The error findings in one line.
    pub fn error_summary(&self) -> String {
        let errors: Vec<String> = self
            .findings
            .iter()
            .filter(|finding| finding.severity == Severity::Error)
            .map(|finding| format!("{}: {}", finding.subject, finding.detail))
            .collect();
        errors.join("; ")
    }
}
