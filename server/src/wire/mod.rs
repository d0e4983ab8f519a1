//! Conversions between the wire and the domain, and nothing else: `from_proto` and `to_proto` by noun.
//!
//! Every message is taken apart field by field, so that a new field cannot be forgotten.

pub(crate) mod dataset;
pub(crate) mod episode;
pub(crate) mod evaluation;
pub(crate) mod field;
#[cfg(feature = "fuzzing")]
pub mod fuzzing;
pub(crate) mod inference;
pub(crate) mod job;
pub(crate) mod kinds;
pub(crate) mod order;
pub(crate) mod policy;
pub(crate) mod schedule;
pub(crate) mod score;
pub(crate) mod scoring;
pub(crate) mod session;
pub(crate) mod snapshot;
pub(crate) mod status;
pub(crate) mod task;
pub(crate) mod upload;
pub(crate) mod worker;
