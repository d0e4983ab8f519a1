//! Where the values of a command line stand in its words.
//!
//! The places have the numbers of clap (`ArgMatches::indices_of`), which counts in the words behind the name of the
//! innermost command, from 1: a flag or the name of an option is one, and each value is one, of which a delimiter
//! separates several in a word. `--` and the names of commands do not count.

use std::ffi::OsString;
use std::ops::Range;

use clap::{Arg, Command};

/// The place of a value.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Place {
    /// The number that clap gives the value.
    pub(super) index: usize,
    /// Its word.
    pub(super) word: usize,
    /// Its bytes in the word.
    pub(super) bytes: Range<usize>,
}

/// The places of the values of a command line that clap has parsed, by their numbers.
pub(super) fn places(mut command: Command, words: &[OsString]) -> Vec<Place> {
    // Options of every command are also options of the innermost one.
    command.build();
    let mut reader = Reader { command: &command, index: 0, found: Vec::new() };
    let (mut waiting, mut values_only) = (None, false);
    for (at, word) in words.iter().enumerate().skip(1) {
        // Replacements are for texts; of another word the beginning is enough.
        let text = word.to_string_lossy();
        if let Some(option) = waiting.take() {
            reader.values(option, at, &text, 0);
        } else if values_only {
            reader.positional(at, &text);
        } else if text == "--" {
            values_only = true;
        } else if let Some(long) = text.strip_prefix("--") {
            waiting = reader.long(at, &text, long);
        } else if text.len() > 1 && text.starts_with('-') {
            waiting = reader.short(at, &text);
        } else if let Some(inner) = reader.command.find_subcommand(&*text) {
            reader = Reader { command: inner, index: 0, found: Vec::new() };
        } else {
            reader.positional(at, &text);
        }
    }
    reader.found
}

/// Reads the words of one command.
struct Reader<'a> {
    command: &'a Command,
    /// The last number.
    index: usize,
    found: Vec<Place>,
}

impl<'a> Reader<'a> {
    /// Reads `--name` or `--name=value`; returns the option if its value is the next word.
    fn long(&mut self, at: usize, text: &str, long: &str) -> Option<&'a Arg> {
        let (name, value) = long.split_once('=').map_or((long, None), |(name, value)| (name, Some(value)));
        let named = |arg: &&Arg| {
            arg.get_long() == Some(name) || arg.get_all_aliases().is_some_and(|aliases| aliases.contains(&name))
        };
        let option = self.command.get_arguments().find(named);
        self.index += 1;
        let option = option.filter(|option| option.get_action().takes_values())?;
        match value {
            Some(value) => self.values(option, at, text, text.len() - value.len()),
            None => return Some(option),
        }
        None
    }

    /// Reads `-a`, `-abc`, `-ovalue` or `-o=value`; returns the option if its value is the next word.
    fn short(&mut self, at: usize, text: &str) -> Option<&'a Arg> {
        let named = |arg: &&Arg, name: char| {
            arg.get_short() == Some(name) || arg.get_all_short_aliases().is_some_and(|others| others.contains(&name))
        };
        for (start, name) in text.char_indices().skip(1) {
            let Some(option) = self.command.get_arguments().find(|arg| named(arg, name)) else {
                // A number below zero.
                self.positional(at, text);
                return None;
            };
            self.index += 1;
            if !option.get_action().takes_values() {
                continue;
            }
            let from = start + name.len_utf8();
            if from == text.len() {
                return Some(option);
            }
            self.values(option, at, text, from + usize::from(text[from..].starts_with('=')));
            return None;
        }
        None
    }

    fn positional(&mut self, at: usize, text: &str) {
        self.split(None, at, text, 0);
    }

    fn values(&mut self, option: &Arg, at: usize, text: &str, from: usize) {
        self.split(option.get_value_delimiter(), at, text, from);
    }

    /// Numbers the values of a word, which begin at a byte of it.
    fn split(&mut self, delimiter: Option<char>, at: usize, text: &str, mut from: usize) {
        let values: Vec<&str> = match delimiter {
            Some(delimiter) => text[from..].split(delimiter).collect(),
            None => vec![&text[from..]],
        };
        for value in values {
            self.index += 1;
            self.found.push(Place { index: self.index, word: at, bytes: from..from + value.len() });
            from += value.len() + delimiter.map_or(0, char::len_utf8);
        }
    }
}

#[cfg(test)]
mod tests {
    use clap::{ArgMatches, CommandFactory as _};

    use super::*;
    use crate::cli::Cli;

    fn small() -> Command {
        let option = |name: &'static str| Arg::new(name).long(name).short(name.chars().next()).num_args(1);
        Command::new("x")
            .arg(Arg::new("quiet").long("quiet").short('q').action(clap::ArgAction::SetTrue).global(true))
            .arg(option("server").global(true))
            .subcommand(
                Command::new("run")
                    .alias("start")
                    .arg(Arg::new("verbose").long("verbose").short('v').action(clap::ArgAction::SetTrue))
                    .arg(option("name").visible_alias("title").action(clap::ArgAction::Append))
                    .arg(option("list").value_delimiter(',').action(clap::ArgAction::Append))
                    .arg(option("below").allow_hyphen_values(true))
                    .arg(Arg::new("first"))
                    .arg(Arg::new("rest").num_args(0..)),
            )
    }

    /// Every value of the innermost command, by clap's numbers and by ours.
    fn both(command: &Command, line: &str) -> [Vec<(usize, String)>; 2] {
        let words: Vec<OsString> = line.split(' ').map(OsString::from).collect();
        let matches = command.clone().try_get_matches_from(&words).unwrap_or_else(|error| panic!("{line}: {error}"));
        let mut inner: &ArgMatches = &matches;
        let mut defined = command.clone();
        defined.build();
        let mut defined = &defined;
        while let Some((name, deeper)) = inner.subcommand() {
            (inner, defined) = (deeper, defined.find_subcommand(name).unwrap());
        }
        let mut theirs = Vec::new();
        for argument in defined.get_arguments().filter(|argument| argument.get_action().takes_values()) {
            let id = argument.get_id().as_str();
            // Those before the name of the command have the numbers of the outer one.
            let given = inner.value_source(id) == Some(clap::parser::ValueSource::CommandLine);
            if given && id != "server" {
                let values = inner.get_raw(id).unwrap().map(|value| value.to_str().unwrap().to_owned());
                theirs.extend(inner.indices_of(id).unwrap().zip(values));
            }
        }
        theirs.sort();
        let text = |place: &Place| words[place.word].to_str().unwrap()[place.bytes.clone()].to_owned();
        let ours = places(command.clone(), &words).iter().map(|place| (place.index, text(place))).collect();
        [theirs, ours]
    }

    #[test]
    fn places_have_the_numbers_of_clap() {
        for line in [
            "x run a b c",
            "x run a --name b c",
            "x run a b --name c d -v e --list f,g h",
            "x run --name=a b --name c --title=d",
            "x run -na b -n=c -n d -vqne",
            "x run -v a -q b",
            "x run -- a --name -v --",
            "x run --name a -- --name=b",
            "x run --list a,b,c d --list=e,f -lg,h i",
            "x run --below -5 a",
            "x run -b-5 a",
            "x run --name run run run",
            "x -q start a start --name start",
            "x --quiet run a",
            "x run --name=a=b c=d",
            "x run a --name  b",
            "x run a -n= b --name= c",
        ] {
            let [theirs, ours] = both(&small(), line);
            assert_eq!(ours, theirs, "{line}");
            assert!(!ours.is_empty(), "{line}");
        }
    }

    #[test]
    fn an_option_before_the_command_is_not_counted_in_it() {
        for line in ["x --server run run a", "x -s=run run a", "x -qsrun start a", "x --server=run -q run a"] {
            let [theirs, ours] = both(&small(), line);
            assert_eq!((&ours, ours.as_slice()), (&theirs, [(1, "a".to_owned())].as_slice()), "{line}");
        }
    }

    #[test]
    fn every_kind_of_argument_here_is_counted_as_clap_does() {
        for line in [
            "gleaner --json label ep_1 ep_2 --outcome failure --reason ep_1 ep_3",
            "gleaner label --outcome=failure -- ep_1 ep_2",
            "gleaner scores latest latest --beta 0.5 --matches",
            "gleaner dataset show latest",
            "gleaner what-if run_1 --top=0.1,0.2 --episodes",
            "gleaner compare-scorers enc_1 enc_2 --scorer ssdf --scorer deminf --train bc",
            "gleaner download ep_1 -o ep_1",
            "gleaner download -oep_1 ep_1",
            "gleaner evaluate --policy pol_1 --task t --episodes 5 --trial-seeds 0,1",
            "gleaner train --dataset=ds_1 --task t --policy act --chunk-length 4 --preset small --key mine",
            "gleaner open latest --in foxglove --scores latest --beta 0.5 --out a.mcap",
        ] {
            let [theirs, ours] = both(&Cli::command(), line);
            assert_eq!(ours, theirs, "{line}");
        }
    }
}
