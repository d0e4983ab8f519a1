//! Which recordings a push sends, each with its task and label: from the options, or from labels files.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use gleaner_client::{Client, PushItem, Skipped, UploadLabel, find_recordings};
use gleaner_proto::v1::Outcome;

use super::{PushArgs, join};
use crate::cmd::labelled::Labels;
use crate::context::Context;
use crate::failure::{Failure, Result};

/// The recordings to send, and what was skipped.
pub(super) async fn items(
    args: &PushArgs,
    context: &Context,
    client: &Client,
) -> Result<(Vec<PushItem>, Vec<Skipped>)> {
    let item = |path: PathBuf, task: String, outcome: Outcome, cohort: String| PushItem {
        path,
        parts: Vec::new(),
        task,
        label: UploadLabel { outcome, cohort, author: context.connection.author() },
    };
    let Some(labels) = labels(args).some()? else {
        let task = known_task(client, context.task(client, args.task.as_deref()).await?, None).await?;
        let outcome = args.outcome.unwrap_or(Outcome::Unknown);
        let cohort = args.cohort.clone().unwrap_or_default();
        if args.join {
            let item = |(path, parts)| PushItem { parts, ..item(path, task.clone(), outcome, cohort.clone()) };
            return Ok((join::recordings(&args.paths)?.into_iter().map(item).collect(), Vec::new()));
        }
        let found = find_recordings(&args.paths)?;
        let items = found.recordings.into_iter().map(|path| item(path, task.clone(), outcome, cohort.clone()));
        return Ok((items.collect(), found.skipped));
    };
    let found = (!args.paths.is_empty()).then(|| find_recordings(&args.paths)).transpose()?;
    let (recordings, skipped) = found.map(|found| (found.recordings, found.skipped)).unzip();
    let rows = labels.rows(recordings)?;
    let skipped = skipped.unwrap_or_default();
    if let Some(found) = labels.found() {
        context.output.note(format_args!("labels from {found}"));
    }
    let mut tasks: HashMap<Option<String>, String> = HashMap::new();
    let mut items = Vec::with_capacity(rows.len());
    for (row, file) in rows {
        let named = args.task.clone().or(row.task);
        let task = match tasks.get(&named) {
            Some(task) => task.clone(),
            None => {
                let place = args.task.is_none().then_some((file, row.line));
                let task = context.task(client, named.as_deref()).await?;
                let task = known_task(client, task, place).await?;
                tasks.insert(named, task.clone());
                task
            }
        };
        items.push(item(row.path, task, row.outcome, row.cohort));
    }
    Ok((items, skipped))
}

/// The labels file that was named, or those in the folders to push, unless a label was given.
pub(super) fn labels(args: &PushArgs) -> Labels<'_> {
    if args.labels.is_none() && (args.join || args.outcome.is_some() || args.cohort.is_some()) {
        return Labels::none(&args.table);
    }
    Labels::of(args.labels.as_deref(), &args.paths, &args.table)
}

/// The task, if the server has it: once, before the first byte, rather than as the same failure of each file.
pub(super) async fn known_task(client: &Client, task: String, place: Option<(&Path, u64)>) -> Result<String> {
    let tasks = client.every_task().await?.tasks;
    let names: Vec<String> = tasks.iter().filter_map(|task| Some(task.spec.as_ref()?.name.clone())).collect();
    if names.contains(&task) || tasks.iter().any(|known| known.id == task) {
        return Ok(task);
    }
    Err(Failure::message(unknown_task(&task, &names, place)))
}

fn unknown_task(task: &str, names: &[String], place: Option<(&Path, u64)>) -> String {
    let place = place.map(|(file, line)| format!("{} line {line}: ", file.display())).unwrap_or_default();
    let problem = format!("{place}the server has no task {task:?}");
    match names {
        [] => format!("{problem}; create it with `gleaner task create task.toml`"),
        [one] if !place.is_empty() => {
            format!("{problem}, but {one:?}: push with --task {one}, or correct the column `task`")
        }
        names => format!("{problem}; it has {}: add --task with one of them, or create the task", names.join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_unknown_task_names_its_line_and_the_remedy() {
        let place = Some((Path::new("labels.csv"), 2));
        let text = unknown_task("PickCube-v0", &["pick_cube".into()], place);
        assert_eq!(
            text,
            "labels.csv line 2: the server has no task \"PickCube-v0\", but \"pick_cube\": push with --task pick_cube, or \
             correct the column `task`"
        );
        assert!(unknown_task("a", &[], None).contains("gleaner task create"));
        assert!(unknown_task("a", &["b".into(), "c".into()], place).contains("it has b, c"));
    }
}
