//! Sets of recordings on disk: the MCAP files, their labels and, apart from them, their marks.
//!
//! Must not know how a recording is made.

use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::agent::{AgentKind, AgentSpec};
use crate::config::SimConfig;
use crate::demonstration::{Demonstration, demonstrate};
use crate::error::SimError;
use crate::task::Task;

/// File name of the labels: file, task, outcome, cohort. Learning may see them.
pub const LABELS: &str = "labels.csv";
/// File name of the marks: file, agent, grade, seed, success, went_wrong. Learning must never see them.
pub const MARKS: &str = "marks.csv";

/// One recording of a set.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedEpisode {
    /// The MCAP file.
    pub path: PathBuf,
    /// Who attempted.
    pub agent: AgentSpec,
    /// The attempt's seed.
    pub seed: u64,
    /// Number of steps.
    pub steps: usize,
    /// Whether the task succeeded.
    pub success: bool,
    /// The mark, as in [`Demonstration::went_wrong`].
    pub went_wrong: Option<u32>,
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
    went_wrong: Option<u32>,
}

/// Records so many attempts of each agent into a folder, with [`LABELS`] and [`MARKS`].
///
/// The attempts have the seeds `seed`, `seed + 1`, … in the order of `agents`, so no two begin alike. `progress` is
/// called after each with the number done. An episode's cohort is its agent's kind.
///
/// # Errors
/// [`SimError::Config`] for settings out of range, [`SimError::Io`], [`SimError::Recording`] or
/// [`SimError::Table`] when something cannot be written.
pub fn record_set(
    dir: &Path,
    task: Task,
    config: SimConfig,
    agents: &[(AgentSpec, usize)],
    seed: u64,
    mut progress: impl FnMut(usize),
) -> Result<Vec<RecordedEpisode>, SimError> {
    config.validate()?;
    std::fs::create_dir_all(dir).map_err(|source| SimError::Io { path: dir.to_owned(), source })?;
    let attempts = agents.iter().flat_map(|&(agent, count)| std::iter::repeat_n(agent, count));
    let mut labels = Table::create(dir.join(LABELS))?;
    let mut marks = Table::create(dir.join(MARKS))?;
    let mut episodes = Vec::new();
    for (agent, seed) in attempts.zip((0..).map(|i| seed.wrapping_add(i))) {
        let demonstration = demonstrate(task, config, agent, seed);
        let file = format!("{task}-{}-{seed:06}.mcap", agent.kind());
        let path = dir.join(&file);
        demonstration.save_mcap(&path)?;
        labels.write(&label(&demonstration, &file))?;
        marks.write(&mark(&demonstration, &file))?;
        episodes.push(RecordedEpisode {
            path,
            agent,
            seed,
            steps: demonstration.steps(),
            success: demonstration.success,
            went_wrong: demonstration.went_wrong,
        });
        progress(episodes.len());
    }
    labels.finish()?;
    marks.finish()?;
    Ok(episodes)
}

fn label<'a>(demonstration: &Demonstration, file: &'a str) -> Label<'a> {
    Label {
        file,
        task: demonstration.task.name(),
        outcome: if demonstration.success { "success" } else { "failure" },
        cohort: demonstration.agent.kind().name(),
    }
}

fn mark<'a>(demonstration: &Demonstration, file: &'a str) -> Mark<'a> {
    Mark {
        file,
        agent: demonstration.agent.kind(),
        grade: demonstration.agent.grade(),
        seed: demonstration.seed,
        success: demonstration.success,
        went_wrong: demonstration.went_wrong,
    }
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
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn agents() -> [(AgentSpec, usize); 2] {
        [(AgentSpec::EXPERT, 2), ("freeze:1".parse().unwrap(), 1)]
    }

    #[test]
    fn a_set_has_a_file_a_label_and_a_mark_for_each_attempt() {
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
        let mark = episodes[2].went_wrong.unwrap();
        assert_eq!(
            read(MARKS),
            format!(
                "file,agent,grade,seed,success,went_wrong\n\
                 pick_cube-expert-000030.mcap,expert,0.0,30,true,\n\
                 pick_cube-expert-000031.mcap,expert,0.0,31,true,\n\
                 pick_cube-freeze-000032.mcap,freeze,1.0,32,false,{mark}\n"
            )
        );
    }

    #[test]
    fn a_folder_that_cannot_be_made_is_named() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("taken");
        std::fs::write(&file, "").unwrap();
        let error = record_set(&file, Task::PickCube, SimConfig::default(), &agents(), 0, |_| {}).unwrap_err();
        assert!(error.to_string().contains("taken"), "{error}");
    }
}
