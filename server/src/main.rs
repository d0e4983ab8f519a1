//! The `gleaner-server` binary: parse, start logging, run, exit code. Knows no room's inside.

use std::process::ExitCode;

use clap::Parser as _;
use gleaner_server::{
    config::{Cli, Command, ServeConfig},
    lock::DataLock,
    telemetry,
};

/// Exit code for a wrong configuration, as in sysexits.
const USAGE: u8 = 64;

#[expect(clippy::print_stderr, reason = "logging may not be up when these are told")]
fn main() -> ExitCode {
    let cli = Cli::parse();
    if let Err(problem) = telemetry::start(&cli.log, cli.log_json) {
        eprintln!("gleaner-server: {problem}");
        return ExitCode::from(USAGE);
    }
    let result = match cli.command {
        Command::Serve(config) => match config.validate() {
            Ok(()) => serve(*config),
            Err(problem) => {
                eprintln!("gleaner-server: {problem}");
                return ExitCode::from(USAGE);
            }
        },
        Command::Worker(config) => gleaner_server::worker::run(config),
        Command::Inspect(config) => gleaner_server::ingest::inspect(&config),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            tracing::error!(%error, "stopped");
            ExitCode::FAILURE
        }
    }
}

#[expect(clippy::print_stdout, reason = "scripts that start a server on port 0 read this line")]
#[tokio::main]
async fn serve(config: ServeConfig) -> gleaner_server::error::Result<()> {
    // Before anything is said: who starts a server must not wait for one that will not serve.
    let lock = DataLock::take(&config.data_dir)?;
    let listener = gleaner_server::bind(config.listen).await?;
    let address =
        listener.local_addr().map_err(|error| gleaner_server::error::Error::internal("asking the address", error))?;
    println!("listening on http://{address}");
    gleaner_server::run(config, lock, listener, async {
        if let Err(error) = gleaner_server::shutdown::requested().await {
            tracing::error!(%error, "cannot listen to signals");
        }
    })
    .await
}
