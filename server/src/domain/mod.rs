//! Values and rules, no IO: the words of this house as types.
//!
//! Knows no wire type, no SQL and no file.

pub mod access;
pub mod attempt;
pub mod client;
pub mod curation;
pub mod dataset;
pub(crate) mod description;
pub mod episode;
pub mod evaluation;
pub mod id;
pub mod job;
pub mod limit;
pub mod live;
pub mod observation;
pub mod order;
pub mod policy;
pub mod schedule;
pub mod score;
pub mod selection;
pub mod sequence;
pub mod snapshot;
pub mod steps;
pub mod tag;
pub mod task;
pub mod time;
pub mod work;
