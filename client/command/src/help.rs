//! The overview that `gleaner help` prints: the commands, grouped by subject. And the parsing of arguments.

use std::ffi::OsString;
use std::fmt::Write as _;

use clap::error::ErrorKind;
use clap::parser::ValueSource;
use clap::{Arg, ArgMatches, Command, CommandFactory as _, FromArgMatches as _};

use crate::cli::Cli;
use crate::connection::GLOBAL;
use crate::ids::{self, Incomplete};

/// Headings with their commands, in the order of the overview.
const GROUPS: [(&str, &[&str]); 8] = [
    ("Episodes", &["inspect", "push", "episodes", "episode", "download", "label", "labels", "delete", "restore"]),
    ("Tasks and snapshots", &["task", "snapshot"]),
    ("Learning", &["pretrain", "score", "train", "pipeline", "schedule", "kinds"]),
    ("Jobs", &["jobs", "job", "metrics", "watch", "cancel"]),
    (
        "Scores and datasets",
        &[
            "runs",
            "scores",
            "histogram",
            "what-if",
            "compare-scorers",
            "score-recording",
            "import-scores",
            "dataset",
            "export",
            "open",
        ],
    ),
    ("Policies", &["policies", "register-policy", "deploy", "rollback", "undeploy", "deployments"]),
    ("Evaluation", &["evaluate", "evaluations", "evaluation", "report-evaluation", "drive"]),
    ("Simulator", &["record", "demo", "experiment"]),
];

/// Parses the arguments of a process; returns also what they leave open.
///
/// # Errors
/// Wrong arguments, and requests for help or the version, which clap handles as errors.
pub(crate) fn parse(words: impl IntoIterator<Item = OsString>) -> Result<(Cli, Incomplete), clap::Error> {
    let mut command = command();
    let matches = command.try_get_matches_from_mut(words)?;
    expect_no_misplaced(&mut command, &matches)?;
    let cli = Cli::from_arg_matches(&matches).map_err(|error| error.format(&mut command))?;
    Ok((cli, ids::incomplete(&matches)))
}

/// Refuses an option that stands before the name of an inner command, where it would have no effect: `gleaner jobs --state
/// failed export`. Options of every command may stand there.
fn expect_no_misplaced(command: &mut Command, matches: &ArgMatches) -> Result<(), clap::Error> {
    let Some((name, inner)) = matches.subcommand() else { return Ok(()) };
    let misplaced = |argument: &&Arg| {
        let given = matches.value_source(argument.get_id().as_str()) == Some(ValueSource::CommandLine);
        given && !argument.is_global_set()
    };
    let named =
        |option: &Arg| option.get_long().map_or_else(|| option.get_id().to_string(), |long| format!("--{long}"));
    let option = command.get_arguments().find(misplaced).map(named);
    if let Some(option) = option {
        let outer = command.get_name();
        let problem = format!(
            "{option} before `{name}` is an option of `{outer}` alone; leave it out, or give it behind `{name}` if \
             `gleaner help {outer} {name}` lists it"
        );
        return Err(command.error(ErrorKind::ArgumentConflict, problem));
    }
    match command.find_subcommand_mut(name) {
        Some(deeper) => expect_no_misplaced(deeper, inner),
        None => Ok(()),
    }
}

/// The definition of the command line with its commands in groups.
pub(crate) fn command() -> Command {
    let command = Cli::command();
    let commands = grouped(&command);
    command.help_template(format!(
        "{{about}}\n\n{{usage-heading}} {{usage}}\n{commands}\n{GLOBAL}:\n{{options}}\n\n\
         `gleaner help COMMAND` shows the options of a command. An id may be given as a unique beginning or as \
         `latest`, a task by its name, an episode by the file name of its recording, and a policy by the name of a \
         deployment that serves it."
    ))
}

fn grouped(command: &Command) -> String {
    let width = GROUPS.iter().flat_map(|(_, names)| *names).map(|name| name.len()).max().unwrap_or_default();
    let mut text = String::new();
    for (heading, names) in GROUPS {
        // Writing to a string cannot fail.
        let _ = writeln!(text, "\n{heading}:");
        for name in names {
            let about = command.find_subcommand(name).and_then(Command::get_about);
            let about = about.map(ToString::to_string).unwrap_or_default();
            let _ = writeln!(text, "  {name:width$}  {about}");
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_command_is_in_one_group() {
        let command = Cli::command();
        let mut defined: Vec<&str> = command.get_subcommands().map(Command::get_name).collect();
        let mut grouped: Vec<&str> = GROUPS.iter().flat_map(|(_, names)| *names).copied().collect();
        defined.sort_unstable();
        grouped.sort_unstable();
        assert_eq!(defined, grouped);
    }

    #[test]
    fn the_overview_has_headings_and_global_options() {
        let help = command().render_help().to_string();
        for part in ["Learning:\n  pretrain", "Global options:\n", "--server <URL>", "--json"] {
            assert!(help.contains(part), "{part} is missing in\n{help}");
        }
    }

    #[test]
    fn options_before_an_inner_command_are_those_of_every_command() {
        let parsed = |line: &str| parse(line.split(' ').map(OsString::from)).map(|(cli, _)| cli);
        for line in [
            "gleaner jobs --json export",
            "gleaner --json jobs export",
            "gleaner jobs export --json",
            "gleaner jobs --json export --task t --tensorboard x",
        ] {
            assert!(parsed(line).unwrap_or_else(|problem| panic!("{line}: {problem}")).json, "{line}");
        }
        for line in ["gleaner jobs --server http://lab:7400 export", "gleaner jobs --state failed --limit 5"] {
            assert!(parsed(line).is_ok(), "{line}");
        }
        for (option, line) in [
            ("--task", "gleaner jobs --task t export"),
            ("--state", "gleaner jobs --json --state failed export --task t"),
            ("--limit", "gleaner jobs --limit 5 export"),
        ] {
            let problem = parsed(line).unwrap_err();
            let expected = format!("{option} before `export` is an option of `jobs` alone");
            assert!(problem.to_string().contains(&expected), "{line}: {problem}");
            assert_eq!(problem.exit_code(), 2, "{line}");
        }
    }
}
