//! Conversions between values and the messages of the API, and nothing else: one module for each noun.
//!
//! Every message is taken apart field by field, so that a new field breaks the build rather than being lost. A wrong
//! field is named by its path in the request. Must not depend on calls, status codes or streams.

pub mod action;
pub mod dataset;
pub mod episode;
pub mod evaluation;
pub mod field;
pub mod job;
pub mod kinds;
pub mod order;
pub mod page;
pub mod policy;
pub mod recording;
pub mod remote;
pub mod schedule;
pub mod score;
pub mod selection;
mod settings;
pub mod snapshot;
pub mod task;
pub mod worker;

pub use settings::{from_struct, to_struct};

#[cfg(test)]
mod tests;
