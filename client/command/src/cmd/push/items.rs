//! Which recordings a push sends, each with its task and label: from the options, or from labels files.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use gleaner_client::{
    BAG_METADATA, Client, LabelledFile, PushItem, Skipped, UploadLabel, find_recordings, read_labels,
};
use gleaner_proto::v1::Outcome;

use super::{PushArgs, join};
use crate::context::Context;
use crate::failure::{Failure, Result};
use crate::words;

/// The labels file that is looked for in folders.
const LABELS: &str = "labels.csv";

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
    let files = labels_files(args);
    if files.is_empty() {
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
    }
    let mut rows = Vec::new();
    for file in &files {
        rows.extend(read_labels(file)?.into_iter().map(|row| (row, file.as_path())));
    }
    let mut skipped = Vec::new();
    if !args.paths.is_empty() {
        let found = find_recordings(&args.paths)?;
        rows = chosen(rows, found.recordings, &files, args.labels.is_none())?;
        skipped = found.skipped;
    }
    if rows.is_empty() {
        return Err(Failure::message(format!("{} lists no recordings", files[0].display())));
    }
    if args.labels.is_none() {
        let named: Vec<String> = files.iter().map(|file| file.display().to_string()).collect();
        context.output.note(format_args!("labels from {}", named.join(", ")));
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
fn labels_files(args: &PushArgs) -> Vec<PathBuf> {
    if let Some(labels) = &args.labels {
        return vec![labels.clone()];
    }
    if args.join || args.outcome.is_some() || args.cohort.is_some() {
        return Vec::new();
    }
    args.paths.iter().map(|path| path.join(LABELS)).filter(|labels| labels.is_file()).collect()
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

/// The rows of these recordings; each must have one.
fn chosen<'a>(
    rows: Vec<(LabelledFile, &'a Path)>,
    recordings: Vec<PathBuf>,
    files: &[PathBuf],
    found: bool,
) -> Result<Vec<(LabelledFile, &'a Path)>> {
    let place = |path: &Path| path.canonicalize().unwrap_or_else(|_| path.to_owned());
    let mut by_place: HashMap<PathBuf, (LabelledFile, &Path)> =
        rows.into_iter().map(|row| (place(&row.0.path), row)).collect();
    let named: Vec<String> = files.iter().map(|file| file.display().to_string()).collect();
    let other = if found { ", or push with --outcome, which ignores the file" } else { "" };
    let (mut rows, mut missing) = (Vec::new(), Vec::new());
    for path in recordings {
        // A rosbag2 folder may be listed by its own name or by that of its first file, whatever their number.
        let folder = path.parent().filter(|folder| folder.join(BAG_METADATA).is_file()).map(place);
        let place = place(&path);
        let part = || by_place.keys().find(|listed| listed.parent() == Some(&place)).cloned();
        let key = [Some(place.clone()), folder].into_iter().flatten().find(|key| by_place.contains_key(key));
        match key.or_else(part).and_then(|key| by_place.remove(&key)) {
            Some((row, file)) => rows.push((LabelledFile { path, ..row }, file)),
            None => missing.push(path.display().to_string()),
        }
    }
    if missing.is_empty() {
        return Ok(rows);
    }
    let verb = if missing.len() == 1 { "is" } else { "are" };
    let problem = format!("{} {verb} not listed in {}", words::some(&missing), named.join(", "));
    Err(Failure::message(format!("{problem}; add a line for each{other}")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_recording_without_a_line_is_named() {
        let labels = PathBuf::from("x/labels.csv");
        let row = |path: &str, line| {
            let (path, cohort) = (path.into(), String::new());
            (LabelledFile { path, line, task: None, outcome: Outcome::Success, cohort }, labels.as_path())
        };
        let rows = vec![row("x/a.mcap", 2), row("x/b.mcap", 3)];
        let files = [labels.clone()];
        assert_eq!(chosen(rows.clone(), vec!["x/b.mcap".into()], &files, false).unwrap(), [row("x/b.mcap", 3)]);
        let message = chosen(rows, vec!["x/c.mcap".into()], &files, true).unwrap_err().to_string();
        assert!(
            message.contains("x/c.mcap is not listed in x/labels.csv") && message.contains("--outcome"),
            "{message}"
        );
    }

    fn listed(path: PathBuf, cohort: &str) -> LabelledFile {
        LabelledFile { path, line: 2, task: None, outcome: Outcome::Success, cohort: cohort.into() }
    }

    #[test]
    fn a_rosbag2_folder_is_listed_by_its_name_or_its_first_file() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        for bag in ["one", "two", "three"] {
            std::fs::create_dir(at(bag)).unwrap();
            for file in [BAG_METADATA, "bag_0.mcap"] {
                std::fs::write(at(bag).join(file), "").unwrap();
            }
        }
        let file = at("labels.csv");
        let rows = [("one", "a"), ("two/bag_0.mcap", "b"), ("three/bag_0.mcap", "c")];
        let rows = rows.map(|(path, cohort)| (listed(at(path), cohort), file.as_path())).to_vec();
        // The third has several parts, so it is pushed as a folder.
        let recordings = vec![at("one/bag_0.mcap"), at("two/bag_0.mcap"), at("three")];
        let found = chosen(rows, recordings.clone(), std::slice::from_ref(&file), true).unwrap();
        let paired: Vec<(&PathBuf, &str)> = found.iter().map(|(row, _)| (&row.path, row.cohort.as_str())).collect();
        assert_eq!(paired, recordings.iter().zip(["a", "b", "c"]).collect::<Vec<_>>());
    }

    #[test]
    fn every_recording_without_a_line_is_named_at_once() {
        let file = PathBuf::from("labels.csv");
        let recordings = vec!["a.mcap".into(), "b.mcap".into(), "c.mcap".into()];
        let rows = vec![(listed("b.mcap".into(), ""), file.as_path())];
        let problem = chosen(rows, recordings, std::slice::from_ref(&file), true).unwrap_err().to_string();
        assert!(
            problem.starts_with("a.mcap, c.mcap are not listed in labels.csv; add a line for each, or"),
            "{problem}"
        );
    }

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
