//! Recordings of the embedded simulator, as `[data]` describes them.

use gleaner_sim::{AgentKind, AgentSpec, Cohort, SimConfig, Task};
use serde::{Deserialize, Serialize};

use crate::cmd::record::RecordSet;

/// The recordings in the simulator.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Settings {
    /// Camera height and width in pixels.
    #[serde(default = "Settings::image")]
    image: u32,
    /// Steps after which an attempt has failed, in recordings and evaluations.
    #[serde(default = "Settings::max_steps")]
    max_steps: u32,
    /// The first recording's seed.
    #[serde(default)]
    seed: u64,
    /// Recordings of the scripted expert.
    experts: usize,
    /// Imperfect agents.
    cohorts: Vec<CohortSettings>,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct CohortSettings {
    /// By default the agent's kind.
    #[serde(default)]
    name: Option<String>,
    /// `KIND:GRADE`, as `gleaner record` takes it.
    agent: String,
    count: usize,
}

impl Settings {
    fn image() -> u32 {
        SimConfig::default().image
    }

    fn max_steps() -> u32 {
        SimConfig::default().max_steps
    }
}

/// The recordings, and a digest of all that they depend on.
///
/// # Errors
/// The field, and what is wrong with it.
pub(super) fn read(task: Task, data: &Settings) -> Result<(RecordSet, String), String> {
    let canonical = serde_json::to_string(&(gleaner_sim::VERSION, task, data)).map_err(|error| error.to_string())?;
    Ok((record_set(task, data)?, super::digest(blake3::hash(canonical.as_bytes()))))
}

fn record_set(task: Task, data: &Settings) -> Result<RecordSet, String> {
    let config = SimConfig { image: data.image, max_steps: data.max_steps };
    config.validate().map_err(|error| format!("data: {error}"))?;
    if data.experts == 0 {
        return Err("data.experts: give at least 1".into());
    }
    let mut cohorts: Vec<Cohort> = vec![(AgentSpec::EXPERT, data.experts).into()];
    for (index, settings) in data.cohorts.iter().enumerate() {
        let field = |problem: String| format!("data.cohorts[{index}].{problem}");
        let agent: AgentSpec = settings.agent.parse().map_err(|error| field(format!("agent: {error}")))?;
        let mut cohort = Cohort::from((agent, settings.count));
        if let Some(name) = &settings.name {
            cohort.name.clone_from(name);
        }
        if cohorts.iter().any(|other| other.name == cohort.name) {
            let problem =
                if cohort.name == AgentKind::Expert.name() { "is the name of the experts" } else { "is duplicated" };
            return Err(field(format!("name: {:?} {problem}; give it another", cohort.name)));
        }
        if cohort.count == 0 {
            return Err(field("count: give at least 1".into()));
        }
        cohorts.push(cohort);
    }
    if cohorts.len() == 1 {
        return Err("data.cohorts: give at least one imperfect agent".into());
    }
    let set = RecordSet { task, config, cohorts, seed: data.seed };
    set.check_seed().map_err(|problem| format!("data.{problem}"))?;
    Ok(set)
}
