//! The `gleaner` command: parse, run, exit code.

mod alike;
mod chart;
mod cli;
mod cmd;
mod connection;
mod context;
mod draft;
mod experiment;
mod failure;
mod figure;
mod help;
mod inspector;
mod json;
mod output;
mod own_server;
mod progress;
mod quality;
mod table;
mod words;

use std::process::ExitCode;

use crate::context::Context;
use crate::failure::Failure;
use crate::output::Output;

/// Exit code for wrong arguments, the same as clap's.
const USAGE: u8 = 2;

fn main() -> ExitCode {
    let cli = match help::parse() {
        Ok(cli) => cli,
        Err(problem) if problem.use_stderr() => {
            Output::usage(&problem);
            return ExitCode::from(USAGE);
        }
        // Help or the version, which repeat no argument.
        Err(help) => help.exit(),
    };
    let output = Output::new(cli.json);
    let done =
        tokio::runtime::Builder::new_multi_thread().enable_all().build().map_err(Failure::from).and_then(|runtime| {
            runtime.block_on(async {
                let context = Context::new(cli.connection, output);
                match cli.command.run(&context).await {
                    Ok(()) => Ok(()),
                    Err(failure) => Err(context.connection.explained(failure).await),
                }
            })
        });
    match done {
        Ok(()) => ExitCode::SUCCESS,
        // The reader of the output has closed it (`gleaner episodes | head`).
        Err(failure) if failure.is_broken_pipe() => ExitCode::SUCCESS,
        Err(failure) => {
            output.error(&failure);
            ExitCode::FAILURE
        }
    }
}
