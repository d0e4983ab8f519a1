//! MCAP recordings to aligned steps and back.
//!
//! A recording has streams of messages, each with its own clock and rate. The crate turns it into an episode of evenly
//! clocked steps, and writes episodes as recordings. It is blocking code and depends on no other crate of the workspace.
//!
//! - [`TaskSpec`] names the cameras, the proprioception and the action of a task, and their topics in a recording.
//! - [`read_episode`] reads a recording as an [`Episode`] and a [`Report`] of its findings, within [`Limits`].
//! - [`EpisodeWriter`] writes an episode; [`extract`] copies a stretch of a recording; [`salvage`] copies the intact part of
//!   a damaged one; [`join`] makes one recording of the parts that a recorder has cut it into; [`cut`] makes several of a
//!   long one, at the messages of an event topic.
//! - [`survey`] reads what a recording holds without a task, for people who describe one.
//! - [`summarize`] reads what a recording states about itself, and [`estimate`] what reading it takes.
//! - [`cache_episode`] reads a recording as a frame cache: a file of which a [`FrameCache`] reads any step.
//! - [`printable`] escapes untrusted text for terminals, pages and logs.
//!
//! Invalid input is an error and never a panic of this crate. The `mcap` crate can panic or reserve too much memory on
//! hostile bytes, so the server reads untrusted files in a process with limits (`gleaner-inspector`).
//!
//! ```
//! use gleaner_recording::{EpisodeWriter, StepRef, TaskSpec, read_episode};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let spec: TaskSpec = serde_json::from_value(serde_json::json!({
//!     "name": "reach", "rate_hz": 10.0, "mappings": [],
//!     "proprioception": [{ "name": "joints", "size": 2 }],
//!     "action": [{ "name": "command", "size": 1 }],
//! }))?;
//! let folder = tempfile::tempdir()?;
//! let path = folder.path().join("episode.mcap");
//! let mut writer = EpisodeWriter::create(std::fs::File::create(&path)?, &spec)?;
//! for step in 0..8_u8 {
//!     let value = f32::from(step);
//!     let step_ref = StepRef { frames: &[], proprioception: &[value, -value], action: &[value] };
//!     writer.step(i64::from(step) * 100_000_000, step_ref)?;
//! }
//! writer.finish()?;
//!
//! let reading = read_episode(&path, &spec)?;
//! assert_eq!(reading.episode.steps(), 8);
//! # Ok(())
//! # }
//! ```

mod align;
mod cache;
mod channels;
mod container;
mod copy;
mod cut;
mod dialect;
mod error;
mod estimate;
mod extract;
mod fill;
mod frames;
#[cfg(feature = "fuzzing")]
#[doc(hidden)]
pub mod fuzzing;
mod image;
mod inspect;
mod join;
mod jpegs;
mod limits;
#[cfg(any(test, feature = "fuzzing"))]
#[cfg_attr(not(feature = "fuzzing"), expect(unreachable_pub, reason = "its re-export is built with the feature only"))]
mod mutants;
mod path;
mod picture;
mod plan;
mod planner;
pub use gleaner_core::printable;
mod read;
mod salvage;
mod survey;
#[cfg(test)]
mod testing;
#[cfg(test)]
mod tests;
mod tracks;
mod transforms;
mod validate;
mod video;
mod whole_file;
mod write;

// What the functions here take and return.
pub use gleaner_core::{
    Alignment, Bound, CameraSource, CameraSpec, Crop, FieldKind, FieldSource, FieldSpec, Finding, FindingCode,
    InspectionEstimate, Mapping, PictureSizes, RecordedSize, RecordingSummary, Report, Severity, Survey,
    SurveyedCamera, SurveyedField, SurveyedTopic, TaskSpec, TopicReport, Transform, ValueRange,
};

pub use cache::{FrameCache, Numbers};
pub use cut::{CutEpisode, Cuts, TimeRange, cut};
pub use error::RecordingError;
pub use estimate::{MAX_MESSAGES, decoded_pixels, estimate, summarize};
pub use extract::{Kept, StepScore, WholeEpisode, extract};
pub use frames::{Episode, FrameBytes, frame_bytes_per_step};
pub use image::{PixelFormat, decode_color, decode_depth, encode_depth_png, encode_jpeg, encode_png};
pub use inspect::pace::{rate_corrections, rounded_rate};
pub use join::join;
pub use jpegs::StepJpegs;
pub use limits::{ImageThreads, Limits, MOST_JSON_DEPTH};
pub use read::{Reading, cache_episode, memory_per_step, read_episode, read_episode_within};
pub use salvage::salvage;
pub use survey::survey;
pub use validate::{validate, validate_within};
pub use write::{CameraMessage, CameraRef, EpisodeWriter, ImageRef, ObservationRef, StepRef, written_mapping};
