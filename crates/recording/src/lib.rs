//! MCAP recordings to aligned steps and back.
//!
//! A recording holds streams of messages, each with its own clock and rate. A [`TaskSpec`] says where the
//! cameras, the proprioception and the action are in it; [`read_episode`] turns it into an [`Episode`] of
//! evenly clocked steps and a [`Report`] of what is wrong with it. [`EpisodeWriter`] goes the other way and
//! [`extract`] copies the kept stretches out of a recording.
//!
//! The crate is plain blocking code. It knows nothing of servers, databases or learning. Bad input is an
//! error, never a panic of this crate's own; the `mcap` crate itself can still panic or reserve too much on
//! hostile bytes, so untrusted files are read in a process with limits.

mod align;
mod cache;
mod channels;
mod container;
mod copy;
mod dialect;
mod error;
mod extract;
mod fill;
mod frames;
#[cfg(feature = "fuzzing")]
#[doc(hidden)]
pub mod fuzzing;
mod image;
mod inspect;
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
#[cfg(test)]
mod testing;
#[cfg(test)]
mod tests;
mod tracks;
mod validate;
mod whole_file;
mod write;

// What the functions here take and return.
pub use gleaner_core::{
    Alignment, CameraSource, CameraSpec, FieldSource, FieldSpec, Finding, FindingCode, Mapping, Report, Severity,
    TaskSpec, TopicReport,
};

pub use error::RecordingError;
pub use extract::{Kept, extract};
pub use frames::{Episode, FrameBytes, frame_bytes_per_step};
pub use image::{PixelFormat, decode_color, decode_depth, encode_jpeg};
pub use limits::{Limits, MOST_JSON_DEPTH};
pub use read::{Reading, read_episode, read_episode_within};
pub use salvage::salvage;
pub use validate::{validate, validate_within};
pub use write::{CameraRef, EpisodeWriter, ImageRef, ObservationRef, StepRef, written_mapping};
