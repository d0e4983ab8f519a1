//! `task draft`: a task file guessed from recordings.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use clap::Args;
use gleaner_client::{BAG_METADATA, LABELS_FILE, TableGuess, guess_table, read_labels};
use gleaner_inspector::Assumed;
use gleaner_recording::printable;
use serde_json::json;

use crate::context::Context;
use crate::draft::{Draft, Known, draft, of_description};
use crate::failure::{Failure, Result};
use crate::inspector::Inspector;
use crate::intake::{self, Intake};
use crate::words;

#[derive(Args, Debug)]
pub(crate) struct DraftArgs {
    /// Recordings, or folders that are searched for *.mcap: several of each kind, so that ranges and lengths are known. Or
    /// one dataset of another program, whose features are the task: LeRobot's folder with meta/info.json, robomimic's
    /// *.hdf5.
    #[arg(required = true)]
    paths: Vec<PathBuf>,
    /// Name of the task. Default: the task in the labels.csv beside the recordings, or the name of their folder.
    #[arg(long)]
    name: Option<String>,
    /// Topic of the action; repeat it for several. Default: topics that are named like commands.
    #[arg(long, value_name = "TOPIC")]
    action: Vec<String>,
    /// Steps per second of a dataset of another program that does not state them. Default: 20.
    #[arg(long, value_name = "HZ")]
    rate: Option<f64>,
}

impl DraftArgs {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let (datasets, others) = intake::split(&self.paths);
        let assumed = Assumed { rate_hz: self.rate, ..Assumed::default() };
        intake::expect_datasets(&datasets, &assumed)?;
        if let Some(first) = datasets.first() {
            let alone = |path: &Path| {
                let problem = format!("{} is a dataset of another program; draft a task from it alone", path.display());
                Err(Failure::message(problem))
            };
            if !others.is_empty() {
                return alone(&first.path);
            }
            if !self.action.is_empty() {
                let problem = format!("{} is a dataset of another program, which has no topics", first.path.display());
                return Err(Failure::message(format!("{problem}; leave out --action, and change the draft")));
            }
            let opened = Intake::open_all(context, &datasets, &assumed).await?;
            opened.note(context);
            return match opened.intakes.as_slice() {
                [intake] => {
                    let name = self.name.clone().unwrap_or_else(|| intake.task_name());
                    let path = words::shell_word(&intake.path.display().to_string());
                    show(context, &of_description(&intake.description, name), &path, "")
                }
                _ => alone(&first.path),
            };
        }
        let recordings = intake::recordings(context, &self.paths)?;
        let surveys = Inspector::find()?.survey(&recordings, None).await?;
        let mut unread = 0;
        for (path, error) in surveys.iter().filter_map(|(path, survey)| Some((path, survey.as_ref().err()?))) {
            context.output.note(format_args!("not used: {}: {error}", path.display()));
            unread += 1;
        }
        if unread == surveys.len() {
            return Err(Failure::message("none of the recordings can be read"));
        }
        let labels = table_beside(&recordings).map(|guess| labels_of(&guess)).unwrap_or_default();
        // A name or a word of the table with a line break must not look like a line of ours.
        let labels = printable::field(&labels);
        let paths: Vec<String> = self.paths.iter().map(|path| words::shell_word(&path.display().to_string())).collect();
        let name = self.name.clone().or_else(|| name_beside(&recordings));
        let known = Known { name: name.unwrap_or_else(|| "my_task".to_owned()), action: self.action };
        let read = surveys.iter().filter_map(|(_, survey)| survey.as_ref().ok());
        let draft = draft(read, &known).map_err(Failure::message)?;
        show(context, &draft, &paths.join(" "), &labels)
    }
}

fn show(context: &Context, draft: &Draft, paths: &str, labels: &str) -> Result<()> {
    gleaner_recording::validate(&draft.spec)?;
    let text = draft.to_string();
    for doubt in draft.doubts() {
        context.output.note(doubt);
    }
    context.output.result(|| Ok(json!({ "spec": draft.spec, "toml": text })), || text.clone())?;
    context.output.next(format_args!("look at task.toml, then gleaner push {paths} --task-file task.toml{labels}"));
    Ok(())
}

/// The folder that a recording is in; of one in a rosbag2 folder, the folder that this one is in.
fn beside(recording: &Path) -> Option<&Path> {
    let folder = recording.parent()?;
    if !folder.join(BAG_METADATA).is_file() {
        return Some(folder);
    }
    let outer = folder.parent()?;
    Some(if outer.as_os_str().is_empty() { Path::new(".") } else { outer })
}

/// The only table beside the recordings that may have their labels.
fn table_beside(recordings: &[PathBuf]) -> Option<TableGuess> {
    let name = |recording: &PathBuf| {
        let folder = recording.parent().filter(|folder| folder.join(BAG_METADATA).is_file());
        let name = if let Some(folder) = folder { folder.file_name() } else { recording.file_stem() };
        Some(name?.to_string_lossy().into_owned())
    };
    let names: BTreeSet<String> = recordings.iter().filter_map(name).collect();
    let folders: BTreeSet<&Path> = recordings.iter().filter_map(|path| beside(path)).collect();
    let places = folders.into_iter().flat_map(|folder| folder.ancestors().take(2)).collect::<BTreeSet<_>>();
    let mut found = places.into_iter().filter_map(|folder| {
        let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
        guess_table(folder, &names)
    });
    found.next().filter(|_| found.next().is_none())
}

/// The options that read the labels of a table, and what to decide about them.
fn labels_of(guess: &TableGuess) -> String {
    let TableGuess { table, file, outcome, cohort, words, success } = guess;
    let column = cohort.as_ref().map(|cohort| format!(",cohort={cohort}")).unwrap_or_default();
    let columns = words::shell_word(&format!("file={file},outcome={outcome}{column}"));
    let word = success.as_ref().map_or_else(|| "WORD".to_owned(), |word| words::shell_word(word));
    let why = match (success, cohort) {
        (Some(word), Some(cohort)) => format!("if \"{word}\" is a success: its rows have no {cohort}"),
        _ => format!(
            "if that is the table of labels: WORD is what {outcome} has for a success, of {}",
            words::some(words)
        ),
    };
    format!(
        " --labels {} --label-columns {columns} --success-value {word} ({why})",
        words::shell_word(&table.display().to_string())
    )
}

/// The name that labels beside the recordings have for their task, or else that of their folder; of a folder named after
/// what it holds, such as `recordings`, the name of the folder above.
fn name_beside(recordings: &[PathBuf]) -> Option<String> {
    let parents = recordings.iter().filter_map(|path| beside(path)).collect::<BTreeSet<&Path>>();
    let tasks = parents.iter().filter_map(|folder| read_labels(&folder.join(LABELS_FILE)).ok()).flatten();
    let tasks: BTreeSet<String> = tasks.filter_map(|row| row.task).collect();
    let folder = parents.first().and_then(|folder| folder.canonicalize().ok());
    let names = folder.iter().flat_map(|folder| folder.ancestors()).filter_map(Path::file_name);
    let mut names = names.map(|name| name.to_string_lossy().into_owned());
    let own = names.next();
    let folder = if own.as_deref().is_some_and(is_general) { names.next().or(own) } else { own };
    let name = if tasks.len() == 1 { tasks.into_iter().next() } else { folder };
    let plain = |c: char| if c.is_ascii_alphanumeric() || "_-.".contains(c) { c } else { '_' };
    name.map(|name| name.chars().take(100).map(plain).collect::<String>()).filter(|name| !name.is_empty())
}

/// Whether the name of a folder tells nothing of a task.
fn is_general(name: &str) -> bool {
    const GENERAL: [&str; 10] =
        ["bags", "data", "dataset", "demonstrations", "demos", "episodes", "mcap", "raw", "recordings", "rosbags"];
    GENERAL.contains(&name.to_lowercase().as_str())
}

#[cfg(test)]
mod tests {
    use clap::Parser as _;

    use super::*;
    use crate::cli::Cli;
    use crate::output::Output;

    #[test]
    fn a_task_is_named_by_its_labels_or_its_folder() {
        let folder = tempfile::tempdir().unwrap();
        let runs = folder.path().join("pick up");
        std::fs::create_dir(&runs).unwrap();
        let recordings = [runs.join("a.mcap")];
        assert_eq!(name_beside(&recordings).unwrap(), "pick_up");
        let within = runs.join("Recordings");
        std::fs::create_dir(&within).unwrap();
        assert_eq!(name_beside(&[within.join("a.mcap")]).unwrap(), "pick_up", "not that of the folder inside");
        std::fs::write(runs.join(LABELS_FILE), "file,task,outcome\na.mcap,PickCube-v0,success\n").unwrap();
        assert_eq!(name_beside(&recordings).unwrap(), "PickCube-v0");
        let bag = recordings[0].parent().unwrap().join("run_1");
        std::fs::create_dir(&bag).unwrap();
        std::fs::write(bag.join(BAG_METADATA), "").unwrap();
        assert_eq!(name_beside(&[bag.join("run_1_0.mcap")]).unwrap(), "PickCube-v0", "not that of the bag");
    }

    /// Neither needs a server or an inspector.
    #[tokio::test]
    async fn an_option_of_the_other_kind_of_input_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
        for name in ["a.mcap", "b.hdf5"] {
            std::fs::write(path(name), "").unwrap();
        }
        for (command, part) in [
            (vec!["task", "draft", &path("a.mcap"), "--rate", "30"], "--rate applies to datasets of other programs"),
            (vec!["inspect", &path("a.mcap"), "--rate", "30"], "--rate applies to datasets of other programs"),
            (vec!["push", &path("a.mcap"), "--rate", "30"], "--rate applies to datasets of other programs"),
            (vec!["task", "draft", &path("b.hdf5"), "--action", "/cmd"], "leave out --action"),
        ] {
            let words = [vec!["gleaner", "--server", "http://127.0.0.1:9"], command].concat();
            let cli = Cli::try_parse_from(words).unwrap();
            let context = Context::new(cli.connection, Output::new(false));
            let message = cli.command.run(&context).await.unwrap_err().to_string();
            assert!(message.contains(part), "{message}");
        }
    }
}
