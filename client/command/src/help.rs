//! The overview that `gleaner help` prints: the commands, grouped by subject.

use std::ffi::OsString;
use std::fmt::Write as _;

use clap::{Command, CommandFactory as _, FromArgMatches as _};

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
    ("Policies", &["policies", "register-policy", "deploy", "rollback", "deployments"]),
    ("Evaluation", &["evaluate", "evaluations", "evaluation", "report-evaluation", "drive"]),
    ("Simulator", &["record", "demo", "experiment"]),
];

/// Parses the arguments of a process; returns also what they leave open.
///
/// # Errors
/// Wrong arguments, and requests for help or the version, which clap handles as errors.
pub(crate) fn parse(words: impl IntoIterator<Item = OsString>) -> Result<(Cli, Incomplete), clap::Error> {
    let matches = command().try_get_matches_from(words)?;
    let cli = Cli::from_arg_matches(&matches).map_err(|error| error.format(&mut command()))?;
    Ok((cli, ids::incomplete(&matches)))
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
}
