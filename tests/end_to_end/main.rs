//! End to end: real server processes on port 0, real workers, real clients, recordings of the embedded simulator.
//!
//! One binary, because each one links libtorch. Test files hold tests; their helpers are in `support/`. No test sleeps:
//! every wait is for an event.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stderr,
    clippy::wildcard_enum_match_arm,
    missing_docs,
    unreachable_pub,
    reason = "tests"
)]

mod support;

mod access;
mod bad_input;
mod bad_settings;
mod blob_store;
mod command;
mod compare_scorers;
mod connections;
mod crash;
mod deadlines;
mod discovery;
mod drain;
mod evaluate_ranks;
mod evaluations;
mod experiment;
mod exporting;
mod file_limit;
mod first_minutes;
mod foreign_datasets;
mod found_datasets;
mod full_disk;
mod hostile_text;
mod image_weights;
mod importing;
mod inference;
mod lists;
mod load;
mod lost_response;
mod maintenance;
mod method;
mod modules;
mod opening;
mod operator;
mod pages;
mod plan;
mod postgres;
mod prose;
mod ranks;
mod real_recordings;
mod refusals;
mod remote_policies;
mod restart;
mod rollouts;
mod schedules;
mod score_ranks;
mod scoring;
mod selection;
mod serving;
mod short_ids;
mod slurm;
mod split_recordings;
mod stages;
mod standby;
mod task_reference;
mod telemetry;
mod tidy;
mod video;
