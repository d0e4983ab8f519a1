//! Conversions between the wire and the domain, and nothing else: `from_proto` and `to_proto` by noun.
//!
//! Every message is taken apart field by field, so that a new field cannot be forgotten.

#[cfg(feature = "fuzzing")]
pub mod fuzzing;
pub(crate) mod import;
pub(crate) mod inference;
pub(crate) mod scoring;
pub(crate) mod session;
pub(crate) mod status;
pub(crate) mod task;
pub(crate) mod upload;

pub(crate) use gleaner_core::proto::{
    dataset, episode, evaluation, field, job, kinds, page, policy, remote, schedule, score, selection, snapshot, worker,
};
