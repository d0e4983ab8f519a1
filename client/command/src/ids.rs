//! Ids as people give them: a unique beginning, `latest`, for a policy the name of a deployment, and for an episode, deleted
//! or not, the file name of its recording.
//!
//! The arguments of the process are completed before a command sees them, so that every command takes full ids only. An
//! id that nothing begins with is left as it is, and the server rejects it by name.

mod choice;
mod deployment;
mod file_name;
mod kind;
mod listed;
mod place;

use std::ffi::OsString;

use clap::parser::ValueSource;
use clap::{ArgMatches, Command};
use gleaner_client::Client;

use crate::context::Context;
use crate::failure::{Failure, Result};

use choice::{choose, newest_note};
pub(crate) use file_name::{of_bag, stem};
pub(crate) use kind::Kind;
use kind::kind;
use listed::Tasks;
pub(crate) use listed::{encoders, every_page};

/// The word for the newest one.
const LATEST: &str = "latest";
/// Characters of an id behind its prefix.
const ULID: usize = 26;

/// An argument that is not a full id.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Given {
    /// Its number among the values of the command, as clap counts.
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
    /// Whether the command takes `--task` beside ids.
    limits: bool,
    /// The full id of the episode that it names.
    episode: Option<String>,
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
    let (mut found, mut episode) = (Vec::new(), None);
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
        for (index, text) in indices.zip(values).filter_map(|(index, text)| Some((index, text.to_str()?))) {
            let kind = if kind == Kind::Encoder && text.starts_with("snap_") { Kind::Snapshot } else { kind };
            let rest = text.strip_prefix(kind.prefix());
            let begins = rest.is_some_and(|rest| rest.len() < ULID);
            let full = rest.is_some_and(is_ulid);
            if full && kind == Kind::Episode {
                episode = Some(text.to_owned());
            }
            // What is to be deleted is named by its id.
            let recording = matches!(kind, Kind::Episode | Kind::Deleted) && command != "delete";
            let file = recording && !full;
            // The name of a deployment may have any characters of an id.
            let named = file || (kind == Kind::Policy && !full);
            if begins || named || text == LATEST {
                found.push(Given { index, kind, text: text.to_owned(), by_file: file });
            }
        }
    }
    found.sort_by_key(|given| given.index);
    let task = inner.try_get_one::<String>("task");
    // `label` has it for the rows of --from, in place of ids.
    let limits = task.is_ok() && command != "label";
    Incomplete { ids: found, limits, task: task.ok().flatten().cloned(), episode }
}

/// The arguments of a command line, by its definition, with full ids.
///
/// # Errors
/// An ambiguous beginning of ids, and `latest` in an empty list, are refused.
pub(crate) async fn complete(
    context: &Context,
    (command, words): (Command, Vec<OsString>),
    Incomplete { ids: given, task, limits, mut episode }: Incomplete,
) -> Result<Vec<OsString>> {
    let client = context.client().await?;
    let tasks = Tasks::of(&client, task.as_deref()).await?;
    let mut full = vec![String::new(); given.len()];
    let mut episodes = None;
    for (place, Given { kind, text, by_file, .. }) in runs_last(&given) {
        let latest = text == LATEST;
        let mut note = None;
        let id = if *by_file {
            // A command names episodes of one kind.
            let listed = match episodes.take() {
                Some(listed) => listed,
                None => listed::episodes(&client, &tasks, *kind == Kind::Deleted).await?,
            };
            let listed = episodes.insert(listed);
            if latest {
                note = newest_note(*kind, &listed::of_episodes(&tasks, listed), limits);
            }
            file_name::choose(*kind, text, listed, &tasks, limits)
        } else {
            let beside = match &episode {
                Some(episode) if latest && *kind == Kind::Run => listed::task_of(&client, episode).await?,
                Some(_) | None => None,
            };
            let entries = listed::ids(&client, *kind, beside.as_ref().unwrap_or(&tasks), text).await?;
            if latest {
                let of_its_task = |note| format!("{note}, of the episode's task");
                note = newest_note(*kind, &entries, limits);
                note = if beside.is_some() { note.map(of_its_task) } else { note };
            }
            if *kind == Kind::Policy && !latest {
                let deployments = listed::deployments(&client, &tasks).await?;
                let named = deployment::policy(text, &entries, &deployments, limits).map_err(Failure::message)?;
                note = named.as_ref().and_then(deployment::note);
                Ok(named.map(|named| named.policy))
            } else {
                choose(*kind, text, &entries, limits)
            }
        };
        if let Some(note) = note {
            context.output.note(note);
        }
        full[place] = id.map_err(Failure::message)?.unwrap_or_else(|| text.clone());
        if *kind == Kind::Episode {
            episode = Some(full[place].clone());
        }
    }
    replaced((command, words), &given, &full).map_err(Failure::message)
}

/// The ids that a line leaves open, each with its place, those of score runs last: `latest` is then of the task of the
/// episode beside it (`gleaner scores latest FILE`).
fn runs_last(given: &[Given]) -> Vec<(usize, &Given)> {
    let (runs, others): (Vec<_>, Vec<_>) = given.iter().enumerate().partition(|(_, given)| given.kind == Kind::Run);
    others.into_iter().chain(runs).collect()
}

/// The newest of a task, which a command takes if none is given; a note names it.
pub(crate) async fn newest(context: &Context, client: &Client, kind: Kind, task: Option<&str>) -> Result<String> {
    let task = context.task(client, task).await?;
    let found = listed::ids(client, kind, &Tasks::one(&task), LATEST).await?;
    let Some(id) = found.into_iter().map(|entry| entry.id).max() else {
        return choose(kind, LATEST, &[], true).map(Option::unwrap_or_default).map_err(Failure::message);
    };
    context.output.note(format_args!("{} {id} (the newest of {task})", kind.words().0));
    Ok(id)
}

/// Whether this can be what follows the prefix of an id.
fn is_ulid(rest: &str) -> bool {
    rest.len() == ULID
        && rest.bytes().all(|byte| byte.is_ascii_digit() || (byte.is_ascii_uppercase() && !b"ILOU".contains(&byte)))
}

/// The words of a command line with the given texts replaced, each in its place.
///
/// # Errors
/// A text that is not found in its place.
fn replaced(
    (command, mut words): (Command, Vec<OsString>),
    given: &[Given],
    full: &[String],
) -> std::result::Result<Vec<OsString>, String> {
    let places = place::places(command, &words);
    // From the last on, because a replacement moves what is behind it in its word.
    for (Given { index, text, .. }, full) in given.iter().zip(full).rev() {
        let place = places.binary_search_by_key(index, |place| place.index).ok().and_then(|at| places.get(at));
        let word = place.and_then(|place| Some((place, words.get(place.word)?.to_str()?)));
        let found = word.filter(|(place, word)| word.get(place.bytes.clone()) == Some(text));
        let Some((place, word)) = found else {
            return Err(format!("{text}: its place among the arguments is not clear; give the full id {full}"));
        };
        let mut new = word.to_owned();
        new.replace_range(place.bytes.clone(), full);
        let at = place.word;
        words[at] = new.into();
    }
    Ok(words)
}

#[cfg(test)]
mod tests;
