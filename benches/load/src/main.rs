//! The `load-test` binary: parse, load, exit code.

use std::process::ExitCode;

use clap::Parser as _;
use gleaner_bench_load::{Options, run};
use gleaner_bench_serving::report::say;

/// One thread: the load must not take more of the machine than it needs. Hostile clients have another.
#[tokio::main(flavor = "current_thread")]
async fn main() -> ExitCode {
    let options = Options::parse();
    match run(&options).await.and_then(|report| report.tell(options.out.as_deref())) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            say(&format!("load-test: {error}"));
            ExitCode::FAILURE
        }
    }
}
