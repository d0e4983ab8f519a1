//! Helpers of the end-to-end tests, one module for each concern: servers, clients, recordings, faults, waits. Tests use
//! this module; it depends on no test.

pub mod api;
pub mod blob_store;
pub mod browser;
pub mod command;
pub mod crash;
pub mod data_folder;
pub mod database;
pub mod disk;
pub mod errors;
pub mod experiments;
pub mod files;
pub mod gate;
pub mod http;
pub mod lab;
pub mod postgres;
pub mod process;
pub mod robot;
pub mod rollouts;
pub mod rpc;
pub mod rust_source;
pub mod scores;
pub mod secure;
pub mod server;
pub mod shared;
pub mod skipped;
pub mod slurm;
pub mod wait;
