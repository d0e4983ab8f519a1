//! End to end: real server processes on port 0, real workers, real clients, recordings of the embedded simulator.
//!
//! One binary, because each one links libtorch. Nothing here sleeps: every wait is for an event.
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

mod access;
mod api;
mod bad_input;
mod bad_settings;
mod command;
mod connections;
mod crash;
mod drain;
mod evaluations;
mod experiment;
mod face;
mod file_limit;
mod full_disk;
mod happy;
mod hostile_text;
mod in_time;
mod inference;
mod lab;
mod live;
mod load;
mod maintenance;
mod method;
mod operator;
mod pages;
mod prose;
mod real_recordings;
mod refusals;
mod restart;
mod rollouts;
mod schedules;
mod scoring;
mod selection;
mod server;
mod shared;
mod skipped;
mod telemetry;
mod tidy;
