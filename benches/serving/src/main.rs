//! The `bench-serving` binary: parse, measure, exit code.

use std::process::ExitCode;

use clap::Parser as _;
use gleaner_bench_serving::{cli::Options, interrupt::unless_interrupted, report, run};

/// One thread, so that the load uses little of the machine.
#[tokio::main(flavor = "current_thread")]
async fn main() -> ExitCode {
    match unless_interrupted(run(&Options::parse())).await {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            report::progress(&format!("bench-serving: {error}"));
            ExitCode::FAILURE
        }
    }
}
