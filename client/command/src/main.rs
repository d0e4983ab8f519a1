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
mod interrupt;
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
            let done = runtime.block_on(async {
                let context = Context::new(cli.connection, output);
                let interrupted = interruption(&cli.command);
                let work = run(cli.command, incomplete, &context);
                let done = match interrupted {
                    Some(interrupted) => interrupt::unless_interrupted(work, interrupted).await,
                    None => work.await,
                };
                match done {
                    Ok(()) => Ok(()),
                    Err(failure) => Err(context.connection.explained(failure).await),
                }
            });
            // Reads and copies of files that were interrupted are not waited for.
            runtime.shutdown_background();
            done
        });
    match done {
        Ok(()) => ExitCode::SUCCESS,
        // The reader of the output has closed it (`gleaner episodes | head`).
        Err(failure) if failure.is_broken_pipe() => ExitCode::SUCCESS,
        Err(failure) => {
            output.error(&failure);
            ExitCode::from(failure.exit_code())
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

/// The failure of an interrupted command that has temporary files, such as copies of recordings, which are then removed.
/// `None` where the signal may end the process at once, or the command handles it.
fn interruption(command: &Command) -> Option<&'static str> {
    if matches!(command, Command::Push(_)) {
        Some("interrupted; the same command resumes, and what is stored is not sent again")
    } else if matches!(command, Command::Inspect(_) | Command::Task(_)) {
        Some("interrupted")
    } else if matches!(command, Command::Download(_)) {
        Some("interrupted; no file was written")
    } else if matches!(command, Command::Open(_)) {
        Some("interrupted; an episode that was written remains")
    } else if matches!(command, Command::Export(_)) {
        Some("interrupted; no files were written, and a job that was submitted continues (`gleaner jobs`)")
    } else {
        None
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser as _;

    use super::*;
    use crate::cli::Cli;

    #[test]
    fn commands_with_copies_of_recordings_remove_them() {
        let message = |line: &str| interruption(&Cli::try_parse_from(line.split(' ')).unwrap().command);
        for line in [
            "gleaner push a.mcap --ranges times.csv",
            "gleaner task check task.toml data.hdf5",
            "gleaner inspect data.hdf5",
            "gleaner download ep_1 --out a.mcap",
            "gleaner export ds_1 --out a",
            "gleaner open ep_1 --in rerun",
        ] {
            assert!(message(line).unwrap().starts_with("interrupted"), "{line}");
        }
        // They end at once, or stop a server of their own.
        for line in [
            "gleaner episodes",
            "gleaner watch job_1",
            "gleaner demo --server-bin a --dir b",
            "gleaner experiment a.toml --out x",
        ] {
            assert_eq!(message(line), None, "{line}");
        }
    }
}
