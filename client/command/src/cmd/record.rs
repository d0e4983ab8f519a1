//! `record`: demonstrations in the simulator, as recordings with their labels beside them.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use clap::Args;
use gleaner_sim::{AgentSpec, Cohort, RecordedEpisode, SimConfig, Task};
use serde_json::{Value, json};

use super::task::sim_config;
use crate::context::Context;
use crate::failure::{Failure, Result};
use crate::words;

/// Evaluation jobs try seed s on the simulator's attempts 2³² · (s + 1) and on.
const EVALUATED: u64 = 1 << 32;

/// An agent and how many episodes it records: `[NAME=]KIND[:GRADE][+false_start]:COUNT`.
#[derive(Clone, Debug)]
pub(crate) struct CohortArg(Cohort);

impl FromStr for CohortArg {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let (name, rest) = text.split_once('=').map_or((None, text), |(name, rest)| (Some(name), rest));
        let (agent, count) = rest.rsplit_once(':').ok_or_else(|| {
            format!(
                "{text:?}: expected [NAME=]KIND[:GRADE][+false_start]:COUNT, such as expert:40 or weak=noise:0.5:20"
            )
        })?;
        let agent = agent.parse::<AgentSpec>().map_err(|error| error.to_string())?;
        let count = count.parse().map_err(|_| format!("{text:?}: the count must be a whole number"))?;
        let mut cohort = Cohort::from((agent, count));
        if let Some(name) = name {
            cohort.name = name.to_owned();
        }
        Ok(Self(cohort))
    }
}

#[derive(Args, Debug)]
pub(crate) struct RecordArgs {
    /// Name of the simulated task.
    #[arg(long, default_value = "pick_cube")]
    task: Task,
    /// Output folder for recordings, labels.csv and marks.csv. It must not have a labels.csv yet.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Agent and number of episodes, such as expert:40 or weak=early_release:0.5:20; can be repeated. The name is the
    /// cohort of the episodes. Default: the kind of the agent. With +false_start it moves elsewhere for its first 8 to 20
    /// steps.
    #[arg(long = "agent", required = true, value_name = "[NAME=]KIND[:GRADE][+false_start]:COUNT")]
    agents: Vec<CohortArg>,
    /// Seed of the first recording; each further one adds 1.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Camera height and width in pixels. Default: 32.
    #[arg(long, value_name = "PIXELS")]
    image: Option<u32>,
}

impl RecordArgs {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        expect_no_labels(&self.out)?;
        let config = sim_config(self.image)?;
        let cohorts = self.agents.into_iter().map(|agent| agent.0).collect();
        let set = RecordSet { task: self.task, config, cohorts, seed: self.seed };
        let recorded = record(context, &self.out, set).await?;
        let labels = self.out.join(gleaner_client::LABELS_FILE);
        context.output.result(
            || Ok(document(&self.out, &recorded)),
            || format!("{} recorded in {}", words::counted(recorded.len(), "episode", "episodes"), self.out.display()),
        )?;
        context.output.next(format_args!(
            "gleaner task create --sim {}; gleaner push --labels {}",
            self.task,
            labels.display()
        ));
        Ok(())
    }
}

/// Refuses a folder of an earlier set, whose labels and recordings of the same seeds would be replaced.
fn expect_no_labels(folder: &Path) -> Result<()> {
    let labels = folder.join(gleaner_client::LABELS_FILE);
    if labels.exists() {
        let problem = format!("{} exists and would be replaced", labels.display());
        return Err(Failure::message(format!("{problem}; give another folder, or remove this one first")));
    }
    Ok(())
}

/// What to record.
#[derive(Clone, Debug)]
pub(crate) struct RecordSet {
    pub(crate) task: Task,
    pub(crate) config: SimConfig,
    pub(crate) cohorts: Vec<Cohort>,
    pub(crate) seed: u64,
}

impl RecordSet {
    /// Fails if a recorded attempt could be one of an evaluation's, which begin at 2³²: a policy would be tried on what
    /// it was trained on.
    pub(crate) fn check_seed(&self) -> std::result::Result<(), String> {
        let attempts = self.total();
        let most = EVALUATED.saturating_sub(attempts);
        if self.seed <= most {
            return Ok(());
        }
        let seed = self.seed;
        Err(format!(
            "seed: {seed} is too high; with {attempts} recordings give at most {most}, the seeds of evaluations begin above it"
        ))
    }

    /// Number of recordings.
    pub(crate) fn total(&self) -> u64 {
        self.cohorts.iter().map(|cohort| cohort.count as u64).fold(0, u64::saturating_add)
    }
}

/// Records with a progress bar.
pub(crate) async fn record(context: &Context, folder: &Path, set: RecordSet) -> Result<Vec<RecordedEpisode>> {
    set.check_seed().map_err(Failure::message)?;
    let total = set.total();
    let bar = context.progress.count("record", total);
    let (drawn, folder) = (bar.clone(), folder.to_owned());
    let work = move || {
        gleaner_sim::record_set(&folder, set.task, set.config, &set.cohorts, set.seed, |done| {
            drawn.set_position(done as u64)
        })
    };
    let recorded = tokio::task::spawn_blocking(work).await.map_err(|error| Failure::message(error.to_string()))??;
    bar.finish_and_clear();
    Ok(recorded)
}

fn document(folder: &Path, recorded: &[RecordedEpisode]) -> Value {
    let episode = |episode: &RecordedEpisode| {
        json!({
            "file": episode.path.display().to_string(),
            "agent": episode.agent.to_string(),
            "cohort": episode.cohort,
            "seed": episode.seed,
            "steps": episode.steps,
            "success": episode.success,
            "went_right": episode.went_right,
            "went_wrong": episode.went_wrong,
        })
    };
    json!({
        "labels": folder.join(gleaner_client::LABELS_FILE).display().to_string(),
        "episodes": recorded.iter().map(episode).collect::<Vec<_>>(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_recording_is_an_attempt_of_an_evaluation() {
        let cohorts = vec![Cohort::from((AgentSpec::EXPERT, 3)), Cohort::from((AgentSpec::EXPERT, 2))];
        let check = |seed| {
            let config = SimConfig::default();
            RecordSet { task: Task::PickCube, config, cohorts: cohorts.clone(), seed }.check_seed()
        };
        assert!(check(0).is_ok() && check((1 << 32) - 5).is_ok());
        for seed in [(1 << 32) - 4, 1 << 32, u64::MAX] {
            let message = check(seed).unwrap_err();
            assert!(message.starts_with("seed: ") && message.contains("at most 4294967291"), "{message}");
        }
    }

    #[test]
    fn the_labels_of_an_earlier_set_are_not_replaced() {
        let folder = tempfile::tempdir().unwrap();
        assert!(expect_no_labels(&folder.path().join("new")).is_ok());
        // An interrupted set has recordings and no labels yet.
        std::fs::write(folder.path().join("pick_cube-expert-000000.mcap"), "").unwrap();
        assert!(expect_no_labels(folder.path()).is_ok());
        std::fs::write(folder.path().join(gleaner_client::LABELS_FILE), "").unwrap();
        let message = expect_no_labels(folder.path()).unwrap_err().to_string();
        assert!(message.contains("labels.csv exists") && message.contains("another folder"), "{message}");
    }

    #[test]
    fn the_cohort_of_an_agent_is_its_name_or_its_kind() {
        let cohort = |text: &str| text.parse::<CohortArg>().unwrap().0;
        let weak = cohort("weak=noise:0.5:20");
        assert_eq!((weak.name.as_str(), weak.agent.grade(), weak.count), ("weak", 0.5, 20));
        assert_eq!(cohort("expert:40").name, "expert");
        assert!("expert".parse::<CohortArg>().unwrap_err().contains("[NAME=]KIND[:GRADE][+false_start]:COUNT"));
    }
}
