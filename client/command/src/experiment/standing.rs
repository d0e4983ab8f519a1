//! The progress of an experiment: the result of each stage or why it has none, and which seeds of which cells are
//! settled.

use std::collections::HashSet;

use gleaner_client::has_ended;
use gleaner_proto::v1::{Job, JobState};
use serde::{Deserialize, Serialize};

use super::stage::{Chain, Graph};
use crate::words;

/// A stage's result on the server.
#[derive(Clone, Debug)]
pub(crate) struct StageResult {
    /// Of the snapshot, encoder, score run, dataset, policy or evaluation; it may not exist yet.
    pub(crate) id: String,
    /// The job that makes it; snapshots and datasets need none.
    pub(crate) job: Option<Job>,
}

/// For each stage its result, or why it has none.
pub(crate) type Submitted = Vec<std::result::Result<StageResult, Gap>>;

/// Why a stage has no result.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Gap {
    /// It is not submitted, or its job has not ended.
    NotYet,
    /// It failed, for this reason.
    Failed(String),
}

impl Gap {
    pub(crate) fn problem(self) -> Option<String> {
        match self {
            Self::NotYet => None,
            Self::Failed(problem) => Some(problem),
        }
    }
}

/// Where one seed of a cell stands.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Standing {
    Complete,
    Unfinished,
    /// Which stage failed, and why.
    Failed(String),
}

/// The result of a stage.
pub(crate) fn stage_result(submitted: &Submitted, index: usize) -> Result<&StageResult, Gap> {
    let result = submitted[index].as_ref().map_err(Clone::clone)?;
    match &result.job {
        Some(job) if !has_ended(job.state()) => Err(Gap::NotYet),
        Some(job) if job.state() != JobState::Succeeded => {
            let why = if job.error.is_empty() { String::new() } else { format!(": {}", job.error) };
            Err(Gap::Failed(format!("job {} {}{why}", job.id, words::job_state(job.state()))))
        }
        Some(_) | None => Ok(result),
    }
}

/// Whether a stage without a result has its input: it is done at once by the next submission.
pub(crate) fn one_has_its_input(graph: &Graph, submitted: &Submitted) -> bool {
    graph.stages.iter().zip(submitted).any(|(stage, result)| {
        matches!(result, Err(Gap::NotYet)) && stage.input.is_some_and(|input| stage_result(submitted, input).is_ok())
    })
}

/// Where a seed of a cell stands: failed as soon as one of its stages is.
pub(crate) fn standing(graph: &Graph, submitted: &Submitted, chain: &Chain) -> Standing {
    let mut standing = Standing::Complete;
    for &index in &chain.stages {
        match stage_result(submitted, index) {
            Ok(_) => {}
            Err(Gap::NotYet) => standing = Standing::Unfinished,
            Err(Gap::Failed(problem)) => {
                return Standing::Failed(format!("{} failed: {problem}", graph.stages[index].work.kind()));
            }
        }
    }
    standing
}

/// The seeds of cells that are complete or have failed, each named by its study, cell and seed.
pub(crate) fn settled(graph: &Graph, submitted: &Submitted) -> HashSet<(usize, usize, usize)> {
    let mut settled = HashSet::new();
    for (study, cells) in graph.chains.iter().enumerate() {
        for (cell, chains) in cells.iter().enumerate() {
            for (seed, chain) in chains.iter().enumerate() {
                if standing(graph, submitted, chain) != Standing::Unfinished {
                    settled.insert((study, cell, seed));
                }
            }
        }
    }
    settled
}

/// How many cells a report has, and how many of them are complete, failed in some seed or have outstanding seeds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Progress {
    pub(crate) cells: usize,
    pub(crate) complete: usize,
    pub(crate) failed: usize,
    #[serde(default)]
    pub(crate) unfinished: usize,
}

impl Progress {
    /// Whether results are outstanding.
    pub(crate) fn unfinished(self) -> bool {
        self.unfinished > 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::file::Experiment;
    use gleaner_core::Device;
    use gleaner_proto::v1::Job;

    const FILE: &str = "name = \"x\"\ntask = \"pick_cube\"\n[data]\nexperts = 3\n\
        cohorts = [{ agent = \"noise:1\", count = 2 }]\n[base]\nseeds = [0, 1]\n[[study]]\ntable = \"scoring\"\n\
        axes = { scorer = [\"ssdf\", \"raw\"] }\n";

    fn job(state: JobState) -> Result<StageResult, Gap> {
        let job = Job { id: "job_1".into(), state: state.into(), error: "no memory".into(), ..Job::default() };
        Ok(StageResult { id: "x_1".into(), job: Some(job) })
    }

    #[test]
    fn a_seed_is_settled_once_all_stages_are_done_or_one_failed() {
        let graph = Graph::new(&Experiment::parse(FILE).unwrap(), Device::Cpu);
        // Snapshot; of each seed an encoder, SSDF's scores and raw ones.
        let kinds: Vec<&str> = graph.stages.iter().map(|stage| stage.work.kind()).collect();
        assert_eq!(kinds, ["snapshot", "pretrain", "score", "score", "pretrain", "score", "score"]);
        let mut submitted: Submitted = (0..kinds.len()).map(|_| job(JobState::Queued)).collect();
        submitted[0] = Ok(StageResult { id: "snap_1".into(), job: None });
        assert!(settled(&graph, &submitted).is_empty());

        submitted[1] = job(JobState::Succeeded);
        submitted[2] = job(JobState::Succeeded);
        submitted[3] = job(JobState::Running);
        assert_eq!(settled(&graph, &submitted), HashSet::from([(0, 0, 0)]));

        submitted[4] = job(JobState::Failed);
        submitted[5] = Err(Gap::NotYet);
        assert_eq!(settled(&graph, &submitted), HashSet::from([(0, 0, 0), (0, 0, 1), (0, 1, 1)]));
        assert!(!one_has_its_input(&graph, &submitted), "its input failed");
        submitted[4] = job(JobState::Running);
        assert!(!one_has_its_input(&graph, &submitted), "its input is not there");
        submitted[4] = job(JobState::Succeeded);
        assert!(one_has_its_input(&graph, &submitted));
        submitted[4] = job(JobState::Failed);
        let Standing::Failed(problem) = standing(&graph, &submitted, &graph.chains[0][0][1]) else { unreachable!() };
        assert_eq!(problem, "pretrain failed: job job_1 failed: no memory");
    }
}
