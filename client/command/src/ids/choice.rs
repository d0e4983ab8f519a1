//! What a text stands for among the ids of a server: a unique beginning, or the newest.
//!
//! Pure functions on listings.

use std::collections::BTreeSet;

use super::{Kind, LATEST};

/// Most ids that an error lists.
pub(super) const SHOWN: usize = 4;

/// Something that the server has.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Entry {
    pub(super) id: String,
    /// The name of its task; `None` if one task alone is searched.
    pub(super) task: Option<String>,
}

impl Entry {
    fn shown(&self) -> String {
        match &self.task {
            Some(task) => format!("{} of {task}", self.id),
            None => self.id.clone(),
        }
    }
}

/// The id that a text stands for; `None` if no id begins with it.
///
/// # Errors
/// Several ids that begin so, with their tasks; `limits`: whether the command has `--task`.
pub(super) fn choose(kind: Kind, text: &str, entries: &[Entry], limits: bool) -> Result<Option<String>, String> {
    let (noun, makes) = kind.words();
    if text == LATEST {
        let newest = newest(entries).map(|entry| entry.id.clone());
        // One of one step, as a pipeline makes for scorers that read none, is no choice.
        let which = if kind == Kind::Encoder { "trained " } else { "" };
        return newest.map(Some).ok_or_else(|| format!("there is no {which}{noun} yet; make one with `{makes}`"));
    }
    let mut begin: Vec<&Entry> = entries.iter().filter(|entry| entry.id.starts_with(text)).collect();
    begin.sort_by(|a, b| a.id.cmp(&b.id));
    begin.dedup_by(|a, b| a.id == b.id);
    match begin.as_slice() {
        [] => Ok(None),
        [one] => Ok(Some(one.id.clone())),
        many => {
            let shown: Vec<String> = many.iter().take(SHOWN).map(|entry| entry.shown()).collect();
            let more = if many.len() > SHOWN { ", …" } else { "" };
            let tasks = tasks(many.iter().filter_map(|entry| entry.task.as_deref()));
            Err(format!(
                "{text}: {} ids begin so ({}{more}); give more characters of the {noun}'s id{}",
                many.len(),
                shown.join(", "),
                limit(&tasks, limits)
            ))
        }
    }
}

/// The newest: ids sort by the time at which they were made.
fn newest(entries: &[Entry]) -> Option<&Entry> {
    entries.iter().max_by(|a, b| a.id.cmp(&b.id))
}

/// The note about what `latest` stands for: with its task if the server has several, and the others that have one too.
pub(super) fn newest_note(kind: Kind, entries: &[Entry], limits: bool) -> Option<String> {
    let newest = newest(entries)?;
    let note = format!("{} {} (the newest)", kind.words().0, newest.id);
    let Some(task) = &newest.task else { return Some(note) };
    let others = tasks(entries.iter().filter_map(|entry| entry.task.as_deref()).filter(|other| other != task));
    if others.is_empty() {
        return Some(format!("{note}, of the task {task}"));
    }
    let remedy = if limits { "add --task with one of them" } else { "give an id" };
    Some(format!("{note}, of the task {task}; for the newest of another task ({}) {remedy}", listed(&others)))
}

/// Names of tasks, each once.
pub(super) fn tasks<'a>(names: impl Iterator<Item = &'a str>) -> Vec<String> {
    names.collect::<BTreeSet<&str>>().into_iter().map(str::to_owned).collect()
}

/// What limits a search to one of several tasks, at the end of an error.
pub(super) fn limit(tasks: &[String], limits: bool) -> String {
    if !limits || tasks.len() < 2 {
        return String::new();
    }
    format!(", or add --task with one of: {}", listed(tasks))
}

fn listed(tasks: &[String]) -> String {
    let more = if tasks.len() > SHOWN { ", …" } else { "" };
    format!("{}{more}", tasks[..tasks.len().min(SHOWN)].join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entries(listed: &[(&str, Option<&str>)]) -> Vec<Entry> {
        listed.iter().map(|(id, task)| Entry { id: (*id).into(), task: task.map(str::to_owned) }).collect()
    }

    #[test]
    fn a_beginning_must_be_unique_and_the_latest_must_be_there() {
        let ids = entries(&[("run_01A", None), ("run_01B", None), ("run_02", None)]);
        let choose = |text| choose(Kind::Run, text, &ids, false);
        assert_eq!(choose("run_02"), Ok(Some("run_02".into())));
        assert_eq!(choose("latest"), Ok(Some("run_02".into())));
        assert_eq!(choose("run_9"), Ok(None));
        assert!(choose("run_01").unwrap_err().contains("2 ids begin so (run_01A, run_01B); give more characters"));
        assert!(super::choose(Kind::Run, "latest", &[], false).unwrap_err().contains("gleaner score --wait"));
    }

    #[test]
    fn an_ambiguous_beginning_names_the_task_of_each_id() {
        let ids = entries(&[("run_01A", Some("lift")), ("run_01B", Some("can")), ("run_02", Some("can"))]);
        let with_task = choose(Kind::Run, "run_01", &ids, true).unwrap_err();
        assert!(with_task.contains("(run_01A of lift, run_01B of can)"), "{with_task}");
        assert!(with_task.ends_with("score run's id, or add --task with one of: can, lift"), "{with_task}");
        let without = choose(Kind::Run, "run_01", &ids, false).unwrap_err();
        assert!(
            without.contains("(run_01A of lift, run_01B of can)") && without.ends_with("score run's id"),
            "{without}"
        );
        let one_task = choose(Kind::Run, "run_0", &entries(&[("run_1", Some("can")), ("run_2", Some("can"))]), true);
        assert_eq!(one_task, Ok(None));
        let one_task = choose(Kind::Run, "run_", &entries(&[("run_1", Some("can")), ("run_2", Some("can"))]), true);
        assert!(one_task.unwrap_err().ends_with("score run's id"));
    }

    #[test]
    fn the_note_on_the_latest_names_its_task_and_the_others() {
        let note = |listed: &[(&str, Option<&str>)], limits| newest_note(Kind::Job, &entries(listed), limits).unwrap();
        assert_eq!(note(&[("job_1", None), ("job_2", None)], true), "job job_2 (the newest)");
        let one = note(&[("job_2", Some("lift")), ("job_1", Some("lift"))], true);
        assert_eq!(one, "job job_2 (the newest), of the task lift");
        let several = [("job_2", Some("lift")), ("job_1", Some("can")), ("job_0", Some("pick"))];
        let begin = "job job_2 (the newest), of the task lift; for the newest of another task (can, pick)";
        assert_eq!(note(&several, true), format!("{begin} add --task with one of them"));
        assert_eq!(note(&several, false), format!("{begin} give an id"));
        assert_eq!(newest_note(Kind::Job, &[], true), None);
    }
}
