//! The commands: each file holds a family, its arguments beside what it does with them.
//!
//! Must not depend on `cli`, which lists them.

pub(crate) mod dataset;
pub(crate) mod drive;
mod encoder;
pub(crate) mod episodes;
pub(crate) mod evaluate;
pub(crate) mod evaluations;
pub(crate) mod export;
pub(crate) mod follow;
pub(crate) mod histogram;
pub(crate) mod import_scores;
pub(crate) mod inspect;
pub(crate) mod jobs;
pub(crate) mod kinds;
pub(crate) mod label;
mod label_file;
mod label_table;
mod labelled;
pub(crate) mod metrics;
mod newest_run;
pub(crate) mod open;
pub(crate) mod pipeline;
mod plan;
pub(crate) mod policies;
pub(crate) mod push;
mod queueing;
pub(crate) mod record;
pub(crate) mod register_policy;
pub(crate) mod schedule;
pub(crate) mod score_recording;
pub(crate) mod scores;
pub(crate) mod selection;
pub(crate) mod snapshot;
pub(crate) mod submit;
pub(crate) mod task;
mod training_warnings;
pub(crate) mod trash;
pub(crate) mod what_if;
