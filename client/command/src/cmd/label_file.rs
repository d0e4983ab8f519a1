//! `label --from`: a labels.csv, or another table, applied to episodes that are stored. Must not send recordings.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use gleaner_client::{Client, LabelledFile};
use gleaner_core::proto::episode::MANY_EPISODES;
use gleaner_proto::v1::{Episode, LabelEpisodesRequest, ListEpisodesRequest, Task};

use super::label_table::LabelTableArgs;
use crate::context::Context;
use crate::failure::{Failure, Result};
use crate::ids::{every_page, of_bag, stem};
use crate::words;

/// Labels the episodes that the file names, and leaves those that have their label already; returns the changed ones.
///
/// # Errors
/// A row without an episode, with several, or of an unknown or another task; then no label is changed.
pub(super) async fn label(
    context: &Context,
    client: &Client,
    (file, table): (&Path, &LabelTableArgs),
    (task, reason): (Option<&str>, &str),
) -> Result<Vec<Episode>> {
    let rows = table.read(file)?;
    let refused = |problem: String| Failure::message(format!("{}: {problem}; no label was changed", file.display()));
    let tasks = client.every_task().await?.tasks;
    // The rows of every task have their episodes before the first label is changed.
    let mut new = Changes::new();
    for (task, rows) in by_task(&rows, task, &tasks).map_err(refused)? {
        let request = ListEpisodesRequest { task: task.to_owned(), page_size: 1000, ..ListEpisodesRequest::default() };
        let episodes = every_page(client, request).await?.episodes;
        for (label, ids) in changes(task, &rows, &episodes).map_err(refused)? {
            new.entry(label).or_default().extend(ids);
        }
    }
    let mut changed = Vec::new();
    for request in requests(new, &context.connection.author(), reason) {
        changed.extend(client.episodes().label_episodes(request).await?.into_inner().episodes);
    }
    context.output.note(format_args!("{} of {} labels of {} are new", changed.len(), rows.len(), file.display()));
    Ok(changed)
}

/// The ids of the episodes for each new label: an outcome, and a cohort if that changes too.
type Changes = BTreeMap<(i32, Option<String>), Vec<String>>;

/// The calls that make the changes, each with as many episodes as the server takes.
fn requests(changes: Changes, author: &str, reason: &str) -> Vec<LabelEpisodesRequest> {
    let request = |outcome, cohort: &Option<String>, ids: &[String]| LabelEpisodesRequest {
        episode_ids: ids.to_vec(),
        outcome,
        cohort: cohort.clone(),
        author: author.to_owned(),
        reason: reason.to_owned(),
    };
    let parts = |((outcome, cohort), ids): ((i32, Option<String>), Vec<String>)| {
        ids.chunks(MANY_EPISODES).map(|ids| request(outcome, &cohort, ids)).collect::<Vec<_>>()
    };
    changes.into_iter().flat_map(parts).collect()
}

fn name_of(task: &Task) -> &str {
    task.spec.as_ref().map_or(task.id.as_str(), |spec| spec.name.as_str())
}

/// The name of the task with this name or id.
fn find<'a>(tasks: &'a [Task], named: &str) -> Option<&'a str> {
    tasks.iter().find(|task| task.id == named || name_of(task) == named).map(name_of)
}

/// The rows of each task, by its name: the one that the row names, else the one that was given, else the only one.
fn by_task<'a>(
    rows: &'a [LabelledFile],
    given: Option<&str>,
    tasks: &'a [Task],
) -> std::result::Result<BTreeMap<&'a str, Vec<&'a LabelledFile>>, String> {
    if tasks.is_empty() {
        return Err("the server has no tasks yet; create one with `gleaner task create SPEC.toml`".to_owned());
    }
    let names: Vec<String> = tasks.iter().map(|task| name_of(task).to_owned()).collect();
    let names = words::some(&names);
    let unknown = |named: &str| format!("the server has no task {named:?}, but {names}");
    let given = given.map(|named| find(tasks, named).ok_or_else(|| unknown(named))).transpose()?;
    let only = if let [only] = tasks { Some(name_of(only)) } else { None };
    let mut found: BTreeMap<&str, Vec<&LabelledFile>> = BTreeMap::new();
    for row in rows {
        let line = row.line;
        let task = match &row.task {
            None => given.or(only).ok_or_else(|| {
                format!(
                    "line {line} names no task, and the server has several: name one in the column `task`, or add --task \
                     with one of: {names}"
                )
            })?,
            Some(named) => {
                let task = find(tasks, named);
                if let Some(given) = given.filter(|given| task != Some(*given)) {
                    return Err(format!(
                        "line {line} is of the task {named:?}, and --task is {given:?}: leave out --task to \
                         label every row in its own task, or correct or empty the column `task`"
                    ));
                }
                task.ok_or_else(|| format!("line {line}: {}: correct or empty the column `task`", unknown(named)))?
            }
        };
        found.entry(task).or_default().push(row);
    }
    Ok(found)
}

/// The episodes of each label that is not theirs yet. A label without a cohort keeps the episode's.
fn changes(task: &str, rows: &[&LabelledFile], episodes: &[Episode]) -> std::result::Result<Changes, String> {
    let mut by_name: BTreeMap<&str, Vec<&Episode>> = BTreeMap::new();
    for episode in episodes {
        by_name.entry(stem(&episode.file_name)).or_default().push(episode);
        by_name.entry(&episode.id).or_default().push(episode);
    }
    let (mut missing, mut ambiguous) = (Vec::new(), Vec::new());
    let mut changes = Changes::new();
    let mut named = BTreeSet::new();
    for row in rows {
        let name = row.path.file_name().unwrap_or_default().to_string_lossy();
        let found = by_name.get(stem(&name)).or_else(|| by_name.get(of_bag(&name).as_str()));
        match found.map(Vec::as_slice) {
            None | Some([]) => missing.push(format!("{name} (line {})", row.line)),
            Some([episode]) => {
                if !named.insert(&episode.id) {
                    return Err(format!("line {}: {name} names {} a second time", row.line, episode.id));
                }
                let cohort = Some(row.cohort.clone()).filter(|cohort| !cohort.is_empty());
                let same = episode.outcome == i32::from(row.outcome)
                    && cohort.as_ref().is_none_or(|cohort| *cohort == episode.cohort);
                if !same {
                    changes.entry((row.outcome.into(), cohort)).or_default().push(episode.id.clone());
                }
            }
            Some(_) => ambiguous.push(format!("{name} (line {})", row.line)),
        }
    }
    if !missing.is_empty() {
        return Err(format!("no episode of the task {task} has the id or file name {}", words::some(&missing)));
    }
    if !ambiguous.is_empty() {
        return Err(format!(
            "several episodes of the task {task} have the name {}: give their ids",
            words::some(&ambiguous)
        ));
    }
    Ok(changes)
}

#[cfg(test)]
mod tests {
    use gleaner_proto::v1::{Outcome, TaskSpec};

    use super::*;

    fn row(line: u64, path: &str, outcome: Outcome, cohort: &str) -> LabelledFile {
        LabelledFile { path: path.into(), listed: path.into(), line, task: None, outcome, cohort: cohort.into() }
    }

    fn episode(id: &str, file_name: &str, outcome: Outcome, cohort: &str) -> Episode {
        Episode {
            id: id.into(),
            file_name: file_name.into(),
            outcome: outcome.into(),
            cohort: cohort.into(),
            ..Episode::default()
        }
    }

    fn of_task(line: u64, path: &str, task: Option<&str>) -> LabelledFile {
        LabelledFile { task: task.map(str::to_owned), ..row(line, path, Outcome::Success, "") }
    }

    fn task(id: &str, name: &str) -> Task {
        let spec = TaskSpec { name: name.into(), ..TaskSpec::default() };
        Task { id: id.into(), spec: Some(spec), ..Task::default() }
    }

    #[test]
    fn rows_are_grouped_by_their_tasks() {
        let tasks = [task("task_1", "pick"), task("task_2", "stack")];
        let lines = |rows: &[LabelledFile], given, tasks: &[Task]| -> Vec<(String, Vec<u64>)> {
            let found = by_task(rows, given, tasks).unwrap();
            found.iter().map(|(task, rows)| ((*task).to_owned(), rows.iter().map(|row| row.line).collect())).collect()
        };
        let (pick, stack) = ("pick".to_owned(), "stack".to_owned());
        let mixed = [of_task(2, "a", Some("stack")), of_task(3, "b", Some("pick")), of_task(4, "c", Some("task_2"))];
        assert_eq!(lines(&mixed, None, &tasks), [(pick.clone(), vec![3]), (stack.clone(), vec![2, 4])]);
        let partly = [of_task(2, "a", None), of_task(3, "b", Some("stack"))];
        assert_eq!(lines(&partly, Some("task_2"), &tasks), [(stack, vec![2, 3])]);
        assert_eq!(lines(&partly[..1], None, &tasks[..1]), [(pick, vec![2])]);
    }

    #[test]
    fn a_row_of_another_or_an_unknown_task_is_refused() {
        let tasks = [task("task_1", "pick"), task("task_2", "stack")];
        let refused = |named, given, tasks: &[Task]| by_task(&[of_task(7, "a", named)], given, tasks).unwrap_err();
        let other = refused(Some("stack"), Some("task_1"), &tasks);
        assert!(other.starts_with("line 7 is of the task \"stack\", and --task is \"pick\": leave out"), "{other}");
        let unknown = refused(Some("PickCube-v0"), None, &tasks[..1]);
        assert!(unknown.starts_with("line 7: the server has no task \"PickCube-v0\", but pick: correct"), "{unknown}");
        assert!(refused(None, None, &tasks).ends_with("add --task with one of: pick, stack"));
        assert_eq!(refused(None, Some("pack"), &tasks), "the server has no task \"pack\", but pick, stack");
        assert!(refused(None, None, &[]).contains("gleaner task create"));
    }

    #[test]
    fn labels_that_are_new_are_grouped() {
        let episodes = [
            episode("ep_1", "a.mcap", Outcome::Unknown, "day"),
            episode("ep_2", "b.mcap", Outcome::Success, "day"),
            episode("ep_3", "bag", Outcome::Unknown, "day"),
            episode("ep_4", "d.mcap", Outcome::Unknown, "day"),
        ];
        let rows = [
            row(2, "sub/a.mcap", Outcome::Success, ""),
            row(3, "b", Outcome::Success, "day"),
            row(4, "/data/bag", Outcome::Success, ""),
            row(5, "ep_4", Outcome::Failure, "night"),
        ];
        let expected = [
            ((Outcome::Success.into(), None), vec!["ep_1".to_owned(), "ep_3".to_owned()]),
            ((Outcome::Failure.into(), Some("night".to_owned())), vec!["ep_4".to_owned()]),
        ];
        let rows: Vec<&LabelledFile> = rows.iter().collect();
        assert_eq!(changes("pick", &rows, &episodes).unwrap(), BTreeMap::from(expected));
    }

    #[test]
    fn a_call_has_at_most_the_episodes_that_the_server_takes() {
        let ids = |count: usize| (0..count).map(|at| format!("ep_{at}")).collect::<Vec<_>>();
        let (success, failure) = (i32::from(Outcome::Success), i32::from(Outcome::Failure));
        let changes = Changes::from([((success, None), ids(20_001)), ((failure, Some("night".into())), ids(3))]);
        let calls = requests(changes, "anna", "audit");
        let sizes: Vec<(i32, usize)> = calls.iter().map(|call| (call.outcome, call.episode_ids.len())).collect();
        assert_eq!(sizes, [(success, 10_000), (success, 10_000), (success, 1), (failure, 3)]);
        assert_eq!(calls[2].episode_ids, ["ep_20000"]);
        assert!(calls.iter().all(|call| call.author == "anna" && call.reason == "audit"));
        assert_eq!(calls[3].cohort.as_deref(), Some("night"));
    }

    #[test]
    fn a_row_without_its_one_episode_is_named() {
        let episodes =
            [episode("ep_1", "a.mcap", Outcome::Unknown, ""), episode("ep_2", "a.mcap", Outcome::Unknown, "")];
        let refused = |path| changes("pick", &[&row(7, path, Outcome::Success, "")], &episodes).unwrap_err();
        assert_eq!(refused("c.mcap"), "no episode of the task pick has the id or file name c.mcap (line 7)");
        let bag = [episode("ep_3", "run_0.mcap", Outcome::Unknown, "")];
        assert_eq!(changes("pick", &[&row(1, "bags/run", Outcome::Success, "")], &bag).unwrap().len(), 1);
        assert_eq!(
            refused("x/a.mcap"),
            "several episodes of the task pick have the name a.mcap (line 7): give their ids"
        );
        let twice = [row(2, "ep_1", Outcome::Success, ""), row(3, "x/ep_1", Outcome::Failure, "")];
        assert!(
            changes("pick", &twice.each_ref(), &episodes)
                .unwrap_err()
                .starts_with("line 3: ep_1 names ep_1 a second time")
        );
        let many: Vec<LabelledFile> =
            (2..10).map(|line| row(line, &format!("{line}.mcap"), Outcome::Success, "")).collect();
        let many: Vec<&LabelledFile> = many.iter().collect();
        assert!(changes("pick", &many, &episodes).unwrap_err().ends_with("6.mcap (line 6) and 3 more"));
    }
}
