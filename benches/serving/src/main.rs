//! The `bench-serving` binary: parse, measure, exit code.

use std::process::ExitCode;

use clap::Parser as _;
use gleaner_bench_serving::{cli::Options, report, run};

/// One thread: the load must not take more of the machine than it needs.
#[tokio::main(flavor = "current_thread")]
async fn main() -> ExitCode {
    match run(&Options::parse()).await {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            report::say(&format!("bench-serving: {error}"));
            ExitCode::FAILURE
        }
    }
}
