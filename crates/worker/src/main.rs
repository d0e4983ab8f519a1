//! The `gleaner-worker` binary: one job of the server that starts it. Parses arguments, sets up logs, runs, and returns
//! an exit code.

use std::process::ExitCode;

use clap::Parser as _;
use gleaner_core::printable;
use gleaner_data_folder::access::keep_private;
use gleaner_worker::WorkerConfig;
use tracing_subscriber::{layer::SubscriberExt as _, util::SubscriberInitExt as _};

/// Exit code for a wrong configuration, as in sysexits.
const USAGE: u8 = 64;

#[expect(clippy::print_stderr, reason = "there is no log yet")]
fn main() -> ExitCode {
    keep_private();
    let config = WorkerConfig::parse();
    if let Err(problem) = prepare(&config) {
        eprintln!("gleaner-worker: {}", printable::field(&problem));
        return ExitCode::from(USAGE);
    }
    match gleaner_worker::run(config) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            tracing::error!(%error, "stopped");
            ExitCode::FAILURE
        }
    }
}

fn prepare(config: &WorkerConfig) -> Result<(), String> {
    config.arm_fail_point()?;
    tracing_subscriber::registry().with(config.log.layer()?).try_init().map_err(|error| error.to_string())
}
