//! The `load-test` binary: parse, load, exit code.

use std::process::ExitCode;

use clap::Parser as _;
use gleaner_bench_load::{Options, run};
use gleaner_bench_serving::{interrupt::unless_interrupted, report::progress};

/// One thread, so that the load uses little of the machine. Hostile clients have another.
#[tokio::main(flavor = "current_thread")]
async fn main() -> ExitCode {
    let options = Options::parse();
    match unless_interrupted(run(&options)).await.and_then(|report| report.print(options.out.as_deref())) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            progress(&format!("load-test: {error}"));
            ExitCode::FAILURE
        }
    }
}
