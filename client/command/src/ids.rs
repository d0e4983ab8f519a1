//! Ids as people give them: a unique beginning, `latest`, for a policy the name of a deployment, and for an episode, deleted
//! or not, the file name of its recording.
//!
//! The arguments of the process are completed before a command sees them, so that every command takes full ids only. An
//! id that nothing begins with is left as it is, and the server rejects it by name.

mod file_name;
mod kind;
mod listed;

use std::ffi::{OsStr, OsString};

use clap::ArgMatches;
use clap::parser::ValueSource;
use gleaner_client::Client;

use crate::context::Context;
use crate::failure::{Failure, Result};

pub(crate) use file_name::stem;
pub(crate) use kind::Kind;
use kind::kind;
pub(crate) use listed::{encoders, every_page};

/// The word for the newest one.
const LATEST: &str = "latest";
/// Characters of an id behind its prefix.
const ULID: usize = 26;
/// Most ids that an error lists.
const SHOWN: usize = 4;

/// An argument that is not a full id.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Given {
    /// Its place among the arguments.
    index: usize,
    kind: Kind,
    text: String,
    /// Whether it may be the file name of a recording.
    by_file: bool,
}

/// What a command line leaves open.
#[derive(Clone, Debug, Default)]
pub(crate) struct Incomplete {
    /// Arguments that are not full ids, in their order.
    ids: Vec<Given>,
    /// The task that the command line names.
    task: Option<String>,
}

impl Incomplete {
    /// Whether each id is a full one.
    pub(crate) fn is_empty(&self) -> bool {
        self.ids.is_empty()
    }
}

/// What a parsed command line leaves open.
pub(crate) fn incomplete(matches: &ArgMatches) -> Incomplete {
    let Some((command, mut inner)) = matches.subcommand() else { return Incomplete::default() };
    while let Some((_, deeper)) = inner.subcommand() {
        inner = deeper;
    }
    let mut found = Vec::new();
    for argument in inner.ids() {
        let Some(kind) = kind(command, argument.as_str()) else { continue };
        if inner.value_source(argument.as_str()) != Some(ValueSource::CommandLine) {
            continue;
        }
        let (Ok(Some(values)), Some(indices)) =
            (inner.try_get_raw(argument.as_str()), inner.indices_of(argument.as_str()))
        else {
            continue;
        };
        for (index, text) in indices.zip(values.filter_map(OsStr::to_str)) {
            let kind = if kind == Kind::Encoder && text.starts_with("snap_") { Kind::Snapshot } else { kind };
            let rest = text.strip_prefix(kind.prefix());
            let begins = rest.is_some_and(|rest| rest.len() < ULID);
            // What is to be deleted is named by its id.
            let recording = matches!(kind, Kind::Episode | Kind::Deleted) && command != "delete";
            let file = recording && !rest.is_some_and(is_ulid);
            let named = file || (kind == Kind::Policy && text.contains('@'));
            if begins || named || text == LATEST {
                found.push(Given { index, kind, text: text.to_owned(), by_file: file });
            }
        }
    }
    found.sort_by_key(|given| given.index);
    let task = inner.try_get_one::<String>("task").ok().flatten().cloned();
    Incomplete { ids: found, task }
}

/// The arguments with full ids.
///
/// # Errors
/// An ambiguous beginning of ids, and `latest` in an empty list, are refused.
pub(crate) async fn complete(
    context: &Context,
    words: Vec<OsString>,
    Incomplete { ids: given, task }: Incomplete,
) -> Result<Vec<OsString>> {
    let client = context.client().await?;
    let (mut full, task) = (Vec::with_capacity(given.len()), task.as_deref());
    let mut episodes = None;
    for Given { kind, text, by_file, .. } in &given {
        let id = if *by_file {
            // A command names episodes of one kind.
            let listed = match episodes.take() {
                Some(listed) => listed,
                None => listed::episodes(&client, task, *kind == Kind::Deleted).await?,
            };
            file_name::choose(*kind, text, episodes.insert(listed))
        } else {
            choose(*kind, text, &listed::ids(&client, *kind, task, text).await?)
        };
        let id = id.map_err(Failure::message)?;
        if let (Some(id), LATEST) = (&id, text.as_str()) {
            context.output.note(format_args!("{} {id} (the newest)", kind.words().0));
        }
        full.push(id.unwrap_or_else(|| text.clone()));
    }
    Ok(replaced(words, &given, &full))
}

/// The newest of a task, which a command takes if none is given; a note names it.
pub(crate) async fn newest(context: &Context, client: &Client, kind: Kind, task: Option<&str>) -> Result<String> {
    let task = context.task(client, task).await?;
    if let Some(id) = newest_if_any(context, client, kind, &task).await? {
        return Ok(id);
    }
    choose(kind, LATEST, &[]).map(Option::unwrap_or_default).map_err(Failure::message)
}

/// The newest of a task, if the task has one; a note names it.
pub(crate) async fn newest_if_any(
    context: &Context,
    client: &Client,
    kind: Kind,
    task: &str,
) -> Result<Option<String>> {
    let newest = listed::ids(client, kind, Some(task), LATEST).await?.into_iter().max();
    if let Some(id) = &newest {
        context.output.note(format_args!("{} {id} (the newest of {task})", kind.words().0));
    }
    Ok(newest)
}

/// The id that a text stands for; `None` if no id begins with it.
fn choose(kind: Kind, text: &str, ids: &[String]) -> std::result::Result<Option<String>, String> {
    let (noun, makes) = kind.words();
    if text == LATEST {
        // Ids sort by the time at which they were made.
        let newest = ids.iter().max().cloned();
        return newest.map(Some).ok_or_else(|| format!("there is no {noun} yet; make one with `{makes}`"));
    }
    if kind == Kind::Policy && text.contains('@') {
        return Ok(ids.first().cloned());
    }
    let mut begin: Vec<&String> = ids.iter().filter(|id| id.starts_with(text)).collect();
    begin.sort();
    begin.dedup();
    match begin.as_slice() {
        [] => Ok(None),
        [one] => Ok(Some((*one).clone())),
        many => {
            let shown: Vec<&str> = many.iter().take(SHOWN).map(|id| id.as_str()).collect();
            let more = if many.len() > SHOWN { ", …" } else { "" };
            let count = many.len();
            Err(format!(
                "{text}: {count} ids begin so ({}{more}); give more characters of the {noun}'s id",
                shown.join(", ")
            ))
        }
    }
}

/// Whether this can be what follows the prefix of an id.
fn is_ulid(rest: &str) -> bool {
    rest.len() == ULID
        && rest.bytes().all(|byte| byte.is_ascii_digit() || (byte.is_ascii_uppercase() && !b"ILOU".contains(&byte)))
}

/// The words of a command line with the given texts replaced in their order.
fn replaced(words: Vec<OsString>, given: &[Given], full: &[String]) -> Vec<OsString> {
    let mut rest = given.iter().zip(full).peekable();
    let replace = |word: OsString| {
        let Some(((given, full), text)) = rest.peek().zip(word.to_str()) else { return word };
        let begin = match text.strip_suffix(given.text.as_str()) {
            Some(begin) if begin.is_empty() || (begin.starts_with("--") && begin.ends_with('=')) => begin,
            Some(_) | None => return word,
        };
        let word = format!("{begin}{full}").into();
        rest.next();
        word
    };
    words.into_iter().map(replace).collect()
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory as _;

    use super::*;
    use crate::cli::Cli;

    #[test]
    fn what_is_to_be_deleted_is_not_looked_up_by_file_name() {
        let by_file = |line: &str| -> Vec<bool> {
            let matches = Cli::command().try_get_matches_from(line.split(' ')).unwrap();
            incomplete(&matches).ids.iter().map(|given| given.by_file).collect()
        };
        assert_eq!(by_file("gleaner delete ep_01 ep_demo.mcap"), [false, false]);
        assert_eq!(by_file("gleaner restore ep_01 ep_demo.mcap"), [true, true]);
    }

    fn found(line: &str) -> Vec<(Kind, String)> {
        let matches = Cli::command().try_get_matches_from(line.split(' ')).unwrap();
        incomplete(&matches).ids.into_iter().map(|given| (given.kind, given.text)).collect()
    }

    #[test]
    fn incomplete_ids_are_found_with_their_kind() {
        let full = "run_01ARZ3NDEKTSV4RRFFQ69G5FAV";
        assert_eq!(found(&format!("gleaner scores {full} latest")), [(Kind::Episode, "latest".into())]);
        assert_eq!(found("gleaner train --dataset ds_01 --policy act"), [(Kind::Dataset, "ds_01".into())]);
        assert_eq!(found("gleaner deploy a@b --policy=c@d"), [(Kind::Policy, "c@d".into())]);
        assert_eq!(found(&format!("gleaner scores {full} dir/a.mcap")), [(Kind::Episode, "dir/a.mcap".into())]);
        assert_eq!(found(&full.replace("run_", "gleaner episode ep_")), []);
        assert_eq!(found(&full.replace("run_", "gleaner restore ep_")), []);
        assert_eq!(found("gleaner restore a.mcap"), [(Kind::Deleted, "a.mcap".into())]);
        assert_eq!(found("gleaner delete a.mcap"), []);
        // As long as an id, and none.
        let name = "ep_of_the_second_afternoon_01";
        assert_eq!(found(&format!("gleaner episode {name}")), [(Kind::Episode, name.into())]);
        assert_eq!(found("gleaner dataset show latest"), [(Kind::Dataset, "latest".into())]);
        assert_eq!(found("gleaner compare-scorers snap_1"), [(Kind::Snapshot, "snap_1".into())]);
        assert_eq!(found("gleaner episodes --task latest"), []);
    }

    #[test]
    fn words_are_replaced_in_their_order() {
        let line = "gleaner scores latest latest --beta 0.5";
        let matches = Cli::command().try_get_matches_from(line.split(' ')).unwrap();
        let words = line.split(' ').map(OsString::from).collect();
        let full = replaced(words, &incomplete(&matches).ids, &["run_1".into(), "ep_2".into()]);
        assert_eq!(full, ["gleaner", "scores", "run_1", "ep_2", "--beta", "0.5"]);
        let line = "gleaner score --encoder=enc_0 --wait";
        let matches = Cli::command().try_get_matches_from(line.split(' ')).unwrap();
        let words = line.split(' ').map(OsString::from).collect();
        assert_eq!(replaced(words, &incomplete(&matches).ids, &["enc_01".into()])[2], "--encoder=enc_01");
    }

    #[test]
    fn a_beginning_must_be_unique_and_the_latest_must_be_there() {
        let ids = ["run_01A", "run_01B", "run_02"].map(str::to_owned);
        assert_eq!(choose(Kind::Run, "run_02", &ids), Ok(Some("run_02".into())));
        assert_eq!(choose(Kind::Run, "latest", &ids), Ok(Some("run_02".into())));
        assert_eq!(choose(Kind::Run, "run_9", &ids), Ok(None));
        assert!(choose(Kind::Run, "run_01", &ids).unwrap_err().contains("2 ids begin so (run_01A, run_01B)"));
        assert!(choose(Kind::Run, "latest", &[]).unwrap_err().contains("gleaner score --wait"));
    }

    #[test]
    fn every_argument_for_an_id_has_a_kind() {
        fn check(top: &str, command: &clap::Command, missing: &mut Vec<String>) {
            for argument in command.get_arguments() {
                let help = argument.get_help().map(ToString::to_string).unwrap_or_default();
                let of_id = help.starts_with("Id of") || help.starts_with("Ids of");
                if of_id && kind(top, argument.get_id().as_str()).is_none() {
                    missing.push(format!("{top} {}", argument.get_id()));
                }
            }
            command.get_subcommands().for_each(|inner| check(top, inner, missing));
        }
        let (cli, mut missing) = (Cli::command(), Vec::new());
        cli.get_subcommands().for_each(|command| check(command.get_name(), command, &mut missing));
        assert!(missing.is_empty(), "{missing:?}");
    }
}
