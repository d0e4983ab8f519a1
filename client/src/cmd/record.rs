//! `record`: demonstrations in the simulator, as recordings with their labels beside them.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use clap::Args;
use gleaner_sim::{AgentSpec, RecordedEpisode, SimConfig, Task};
use serde_json::{Value, json};

use super::task::sim_config;
use crate::context::Context;
use crate::failure::{Failure, Result};

/// An agent and how many episodes it records: `KIND[:GRADE]:COUNT`.
#[derive(Clone, Debug)]
pub(crate) struct AgentCount {
    pub(crate) agent: AgentSpec,
    pub(crate) count: usize,
}

impl FromStr for AgentCount {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let (agent, count) = text
            .rsplit_once(':')
            .ok_or_else(|| format!("{text:?}: write KIND[:GRADE]:COUNT, for example expert:40"))?;
        let agent = agent.parse::<AgentSpec>().map_err(|error| error.to_string())?;
        let count = count.parse().map_err(|_| format!("{text:?}: the count must be a whole number"))?;
        Ok(Self { agent, count })
    }
}

#[derive(Args, Debug)]
pub(crate) struct RecordArgs {
    /// The simulated task.
    #[arg(long, default_value = "pick_cube")]
    task: Task,
    /// The folder to write recordings, labels.csv and marks.csv into.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Who records and how often, for example expert:40 or early_release:1.0:20; may be repeated.
    #[arg(long = "agent", required = true, value_name = "KIND[:GRADE]:COUNT")]
    agents: Vec<AgentCount>,
    /// Seed of everything random.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Camera height and width in pixels.
    #[arg(long, value_name = "PIXELS")]
    image: Option<u32>,
}

impl RecordArgs {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let config = sim_config(self.image)?;
        let set = RecordSet { task: self.task, config, agents: self.agents, seed: self.seed };
        let recorded = record(context, &self.out, set).await?;
        let labels = self.out.join("labels.csv");
        context.output.result(
            || Ok(document(&self.out, &recorded)),
            || format!("{} episodes recorded in {}", recorded.len(), self.out.display()),
        )?;
        context.output.next(format_args!(
            "gleaner task create --sim {}; gleaner push --labels {}",
            self.task,
            labels.display()
        ));
        Ok(())
    }
}

/// What to record.
#[derive(Clone, Debug)]
pub(crate) struct RecordSet {
    pub(crate) task: Task,
    pub(crate) config: SimConfig,
    pub(crate) agents: Vec<AgentCount>,
    pub(crate) seed: u64,
}

/// Records with a progress bar.
pub(crate) async fn record(context: &Context, folder: &Path, set: RecordSet) -> Result<Vec<RecordedEpisode>> {
    let total = set.agents.iter().map(|agent| agent.count as u64).sum();
    let bar = context.progress.count("record", total);
    let (drawn, folder) = (bar.clone(), folder.to_owned());
    let agents: Vec<(AgentSpec, usize)> = set.agents.iter().map(|agent| (agent.agent, agent.count)).collect();
    let work = move || {
        gleaner_sim::record_set(&folder, set.task, set.config, &agents, set.seed, |done| {
            drawn.set_position(done as u64)
        })
    };
    let recorded = tokio::task::spawn_blocking(work).await.map_err(|error| Failure::told(error.to_string()))??;
    bar.finish_and_clear();
    Ok(recorded)
}

fn document(folder: &Path, recorded: &[RecordedEpisode]) -> Value {
    let episode = |episode: &RecordedEpisode| {
        json!({
            "file": episode.path.display().to_string(),
            "agent": episode.agent.to_string(),
            "seed": episode.seed,
            "steps": episode.steps,
            "success": episode.success,
            "went_wrong": episode.went_wrong,
        })
    };
    json!({
        "labels": folder.join("labels.csv").display().to_string(),
        "episodes": recorded.iter().map(episode).collect::<Vec<_>>(),
    })
}
