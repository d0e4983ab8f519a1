//! The `gleaner-inspector` binary: one recording under limits. The server and the command line start it and read its exit
//! code, its standard error and, on its standard output, the seconds that it has.

use std::process::ExitCode;

use clap::Parser;
use gleaner_inspector::{Order, inspect};

/// Inspects one recording under limits (started by `gleaner-server` and `gleaner`, not by hand).
#[derive(Debug, Parser)]
#[command(name = "gleaner-inspector", version)]
struct Cli {
    #[command(flatten)]
    order: Order,
}

#[expect(clippy::print_stderr, reason = "its parent logs or shows it")]
fn main() -> ExitCode {
    match inspect(&Cli::parse().order) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("gleaner-inspector: {error}");
            ExitCode::FAILURE
        }
    }
}
