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
mod ids;
mod inspector;
mod intake;
mod json;
mod output;
mod own_server;
mod progress;
mod quality;
mod table;
mod tensorboard;
mod words;

use std::process::ExitCode;

use crate::cli::Command;
use crate::context::Context;
use crate::failure::{Failure, Result};
use crate::ids::Incomplete;
use crate::output::Output;

/// Exit code for wrong arguments, the same as clap's.
const USAGE: u8 = 2;

fn main() -> ExitCode {
    let (cli, incomplete) = match help::parse(std::env::args_os()) {
        Ok(parsed) => parsed,
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
                match run(cli.command, incomplete, &context).await {
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

/// Runs the command, with the ids of its arguments completed.
async fn run(command: Command, incomplete: Incomplete, context: &Context) -> Result<()> {
    if incomplete.is_empty() {
        return command.run(context).await;
    }
    let line = (help::command(), std::env::args_os().collect());
    let words = ids::complete(context, line, incomplete).await?;
    let (cli, _) = help::parse(words).map_err(|problem| Failure::message(problem.to_string()))?;
    cli.command.run(context).await
}
