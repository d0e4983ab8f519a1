//! Sets of recordings on disk: the MCAP files, their labels and, separately, their marks.
//!
//! This module does not depend on the content of a recording.

use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::agent::{AgentKind, AgentSpec};
use crate::config::SimConfig;
use crate::demonstration::{Demonstration, demonstrate};
use crate::error::SimError;
use crate::task::Task;

/// File name of the labels: file, task, outcome, cohort. Learning uses them.
pub const LABELS: &str = "labels.csv";
/// File name of the marks: file, agent, grade, seed, success, went_right, went_wrong, and the departures of all steps
/// separated by spaces. Learning must never use them.
pub const MARKS: &str = "marks.csv";

/// A number of attempts of one agent, with a name.
#[derive(Clone, Debug, PartialEq)]
pub struct Cohort {
    /// The label of its episodes. Two grades of one kind of agent are two cohorts with different names.
    pub name: String,
    /// The agent.
    pub agent: AgentSpec,
    /// The number of attempts.
    pub count: usize,
}

impl From<(AgentSpec, usize)> for Cohort {
    /// A cohort with the name of its agent's kind.
    fn from((agent, count): (AgentSpec, usize)) -> Self {
        Self { name: agent.kind().name().to_owned(), agent, count }
    }
}

/// One recording of a set.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedEpisode {
    /// The MCAP file.
    pub path: PathBuf,
    /// The agent.
    pub agent: AgentSpec,
    /// The cohort's name.
    pub cohort: String,
    /// The attempt's seed.
    pub seed: u64,
    /// Number of steps.
    pub steps: usize,
    /// Whether the task succeeded.
    pub success: bool,
    /// The end of a false start, as in [`Demonstration::went_right`].
    pub went_right: Option<u32>,
    /// The mark, as in [`Demonstration::went_wrong`].
    pub went_wrong: Option<u32>,
    /// The distance of each step from the expert's, as in [`Demonstration::departure`].
    pub departure: Vec<f32>,
}

/// A row of the labels.
#[derive(Serialize)]
struct Label<'a> {
    file: &'a str,
    task: &'a str,
    outcome: &'a str,
    cohort: &'a str,
}

/// A row of the marks.
#[derive(Serialize)]
struct Mark<'a> {
    file: &'a str,
    agent: AgentKind,
    grade: f64,
    seed: u64,
    success: bool,
    went_right: Option<u32>,
    went_wrong: Option<u32>,
    departure: String,
}

/// Records cohort after cohort into a folder, with [`LABELS`] and [`MARKS`]. A pair of agent and count is a cohort too.
///
/// The attempts have the seeds `seed`, `seed + 1`, … in the order of `cohorts`, so that all begin differently. `progress` is
/// called after each attempt with the number of attempts so far.
///
/// # Errors
/// [`SimError::Config`] for settings out of range, [`SimError::Cohort`] for a cohort without a name,
/// [`SimError::Io`], [`SimError::Recording`] or [`SimError::Table`] if a file cannot be written.
pub fn record_set<C: Clone + Into<Cohort>>(
    dir: &Path,
    task: Task,
    config: SimConfig,
    cohorts: &[C],
    seed: u64,
    mut progress: impl FnMut(usize),
) -> Result<Vec<RecordedEpisode>, SimError> {
    config.validate()?;
    let cohorts: Vec<Cohort> = cohorts.iter().cloned().map(Into::into).collect();
    check_names(&cohorts)?;
    std::fs::create_dir_all(dir).map_err(|source| SimError::Io { path: dir.to_owned(), source })?;
    let attempts = cohorts.iter().flat_map(|cohort| std::iter::repeat_n(cohort, cohort.count));
    let mut labels = Table::create(dir.join(LABELS))?;
    let mut marks = Table::create(dir.join(MARKS))?;
    let mut episodes = Vec::new();
    for (cohort, seed) in attempts.zip((0..).map(|i| seed.wrapping_add(i))) {
        let demonstration = demonstrate(task, config, cohort.agent, seed);
        let file = format!("{task}-{}-{seed:06}.mcap", cohort.agent.kind());
        let path = dir.join(&file);
        demonstration.save_mcap(&path)?;
        labels.write(&label(&demonstration, &file, &cohort.name))?;
        marks.write(&mark(&demonstration, &file))?;
        episodes.push(RecordedEpisode {
            path,
            agent: cohort.agent,
            cohort: cohort.name.clone(),
            seed,
            steps: demonstration.steps(),
            success: demonstration.success,
            went_right: demonstration.went_right,
            went_wrong: demonstration.went_wrong,
            departure: demonstration.departure,
        });
        progress(episodes.len());
    }
    labels.finish()?;
    marks.finish()?;
    Ok(episodes)
}

fn check_names(cohorts: &[Cohort]) -> Result<(), SimError> {
    match cohorts.iter().find(|cohort| cohort.name.trim().is_empty()) {
        Some(Cohort { name, .. }) => {
            let detail = "an empty name is not allowed; omit it for the name of the agent's kind";
            Err(SimError::Cohort { name: name.clone(), detail })
        }
        None => Ok(()),
    }
}

fn label<'a>(demonstration: &Demonstration, file: &'a str, cohort: &'a str) -> Label<'a> {
    Label {
        file,
        task: demonstration.task.name(),
        outcome: if demonstration.success { "success" } else { "failure" },
        cohort,
    }
}

fn mark<'a>(demonstration: &Demonstration, file: &'a str) -> Mark<'a> {
    Mark {
        file,
        agent: demonstration.agent.kind(),
        grade: demonstration.agent.grade(),
        seed: demonstration.seed,
        success: demonstration.success,
        went_right: demonstration.went_right,
        went_wrong: demonstration.went_wrong,
        departure: spaced(&demonstration.departure),
    }
}

/// Numbers with four digits after the point, separated by spaces.
fn spaced(numbers: &[f32]) -> String {
    let rounded = |number: &f32| ((number * 1e4).round() / 1e4).to_string();
    numbers.iter().map(rounded).collect::<Vec<_>>().join(" ")
}

/// A table being written, whose errors name its file.
struct Table {
    path: PathBuf,
    rows: csv::Writer<std::fs::File>,
}

impl Table {
    fn create(path: PathBuf) -> Result<Self, SimError> {
        match csv::Writer::from_path(&path) {
            Ok(rows) => Ok(Self { path, rows }),
            Err(source) => Err(SimError::Table { path, source }),
        }
    }

    fn write(&mut self, row: &impl Serialize) -> Result<(), SimError> {
        self.rows.serialize(row).map_err(|source| SimError::Table { path: self.path.clone(), source })
    }

    fn finish(mut self) -> Result<(), SimError> {
        self.rows.flush().map_err(|source| SimError::Io { path: self.path, source })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn agents() -> [(AgentSpec, usize); 2] {
        [(AgentSpec::EXPERT, 2), ("freeze:1".parse().unwrap(), 1)]
    }

    #[test]
    fn set_has_a_file_a_label_and_a_mark_for_each_attempt() {
        let dir = tempfile::tempdir().unwrap();
        let config = SimConfig { image: 8, ..SimConfig::default() };
        let mut done = Vec::new();
        let episodes = record_set(dir.path(), Task::PickCube, config, &agents(), 30, |n| done.push(n)).unwrap();
        assert_eq!(done, [1, 2, 3]);
        assert_eq!(episodes.iter().map(|episode| episode.seed).collect::<Vec<_>>(), [30, 31, 32]);
        assert!(episodes.iter().all(|episode| episode.path.is_file()));
        let read = |name| std::fs::read_to_string(dir.path().join(name)).unwrap();
        assert_eq!(
            read(LABELS),
            "file,task,outcome,cohort\n\
             pick_cube-expert-000030.mcap,pick_cube,success,expert\n\
             pick_cube-expert-000031.mcap,pick_cube,success,expert\n\
             pick_cube-freeze-000032.mcap,pick_cube,failure,freeze\n"
        );
        let marks: Vec<String> = read(MARKS).lines().map(str::to_owned).collect();
        assert_eq!(marks[0], "file,agent,grade,seed,success,went_right,went_wrong,departure");
        assert_eq!(marks[1], format!("pick_cube-expert-000030.mcap,expert,0.0,30,true,,,{}", zeros(episodes[0].steps)));
        let (freeze, mark) = (&episodes[2], episodes[2].went_wrong.unwrap());
        let row = format!("pick_cube-freeze-000032.mcap,freeze,1.0,32,false,,{mark},");
        let departures: Vec<f32> =
            marks[3].strip_prefix(&row).unwrap().split(' ').map(|number| number.parse().unwrap()).collect();
        assert_eq!(departures.len(), freeze.steps);
        assert!(departures.iter().zip(&freeze.departure).all(|(read, kept)| (read - kept).abs() < 1e-4));
    }

    fn zeros(steps: usize) -> String {
        vec!["0"; steps].join(" ")
    }

    #[test]
    fn two_grades_of_one_kind_are_two_cohorts() {
        let dir = tempfile::tempdir().unwrap();
        let config = SimConfig { image: 8, ..SimConfig::default() };
        let level = |name: &str, agent: &str| Cohort { name: name.into(), agent: agent.parse().unwrap(), count: 1 };
        let cohorts = [level("noisy", "noise:0.3"), level("very noisy", "noise:1")];
        let episodes = record_set(dir.path(), Task::StackCube, config, &cohorts, 0, |_| {}).unwrap();
        assert_eq!(episodes.iter().map(|episode| episode.cohort.as_str()).collect::<Vec<_>>(), ["noisy", "very noisy"]);
        let labels = std::fs::read_to_string(dir.path().join(LABELS)).unwrap();
        assert!(labels.lines().nth(1).unwrap().ends_with(",noisy"), "{labels}");
        assert!(labels.lines().nth(2).unwrap().ends_with(",very noisy"), "{labels}");
        let error = record_set(dir.path(), Task::StackCube, config, &[level(" ", "noise:1")], 0, |_| {}).unwrap_err();
        assert!(error.to_string().starts_with("cohort: \" \": an empty name"), "{error}");
    }

    #[test]
    fn error_names_a_folder_that_cannot_be_created() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("taken");
        std::fs::write(&file, "").unwrap();
        let error = record_set(&file, Task::PickCube, SimConfig::default(), &agents(), 0, |_| {}).unwrap_err();
        assert!(error.to_string().contains("taken"), "{error}");
    }
}
