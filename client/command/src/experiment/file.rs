//! The experiment file: the recordings, the base that all cells share, and the studies.

use std::path::Path;

use gleaner_client::ClientError;
use gleaner_sim::{AgentKind, AgentSpec, Cohort, SimConfig, Task};
use serde::{Deserialize, Serialize};
use toml::Table;

use super::study::{Cell, StudySettings, TableKind, one_line};
use crate::cmd::record::RecordSet;
use crate::failure::{Failure, Result};

/// The file as it is written.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ExperimentFile {
    name: String,
    task: Task,
    data: DataSettings,
    #[serde(default)]
    base: Table,
    study: Vec<StudySettings>,
}

/// The recordings in the simulator.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct DataSettings {
    /// Camera height and width in pixels.
    #[serde(default = "DataSettings::image")]
    image: u32,
    /// Steps after which an attempt has failed, in recordings and evaluations.
    #[serde(default = "DataSettings::max_steps")]
    pub(crate) max_steps: u32,
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

impl DataSettings {
    fn image() -> u32 {
        SimConfig::default().image
    }

    fn max_steps() -> u32 {
        SimConfig::default().max_steps
    }
}

/// An experiment that can be run: every field is checked.
#[derive(Clone, Debug)]
pub(crate) struct Experiment {
    pub(crate) name: String,
    /// The task's name on the server: of these recordings alone, so that experiments with the same recordings share
    /// them and others do not mix theirs.
    pub(crate) task: String,
    pub(crate) recordings: RecordSet,
    /// A digest of all that the recordings depend on.
    pub(crate) data_key: String,
    pub(crate) studies: Vec<Study>,
}

/// A study with its cells.
#[derive(Clone, Debug)]
pub(crate) struct Study {
    pub(crate) name: String,
    pub(crate) table: TableKind,
    pub(crate) cells: Vec<Cell>,
}

impl Experiment {
    /// From a file. Errors name the study, cell and field.
    pub(crate) fn read(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(ClientError::io(path))?;
        Self::parse(&text).map_err(|problem| Failure::message(format!("{}: {problem}", path.display())))
    }

    pub(crate) fn parse(text: &str) -> std::result::Result<Self, String> {
        Self::checked(toml::from_str(text).map_err(|error| located(&error, text))?)
    }

    /// From the parsed content of a file.
    pub(super) fn from_table(table: Table) -> std::result::Result<Self, String> {
        Self::checked(table.try_into().map_err(|error: toml::de::Error| one_line(&error))?)
    }

    fn checked(file: ExperimentFile) -> std::result::Result<Self, String> {
        let recordings = recordings(&file)?;
        let names: Vec<&str> = recordings.cohorts.iter().skip(1).map(|cohort| cohort.name.as_str()).collect();
        let base = file.base.clone().try_into::<super::cell::CellSettings>();
        base.map_err(|error| format!("base: {}", one_line(&error)))?
            .check(&names)
            .map_err(|problem| format!("base: {problem}"))?;
        if file.study.is_empty() {
            return Err("study: give at least one [[study]]".into());
        }
        let mut studies: Vec<Study> = Vec::new();
        for study in &file.study {
            let name = study.name().to_owned();
            let cells = study.cells(&file.base, &names).map_err(|problem| format!("study {name:?}: {problem}"))?;
            if studies.iter().any(|other| other.name == name) {
                return Err(format!("study {name:?}: the name is duplicated; rename one"));
            }
            studies.push(Study { name, table: study.table, cells });
        }
        let data_key = data_key(file.task, &file.data)?;
        let task = format!("{}_{data_key}", file.task);
        Ok(Self { name: file.name, task, recordings, data_key, studies })
    }

    /// The imperfect cohorts' names.
    pub(crate) fn imperfect_cohorts(&self) -> impl Iterator<Item = &str> {
        self.recordings.cohorts.iter().skip(1).map(|cohort| cohort.name.as_str())
    }
}

fn recordings(file: &ExperimentFile) -> std::result::Result<RecordSet, String> {
    let data = &file.data;
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
    let set = RecordSet { task: file.task, config, cohorts, seed: data.seed };
    set.check_seed().map_err(|problem| format!("data.{problem}"))?;
    Ok(set)
}

fn data_key(task: Task, data: &DataSettings) -> std::result::Result<String, String> {
    let canonical = serde_json::to_string(&(gleaner_sim::VERSION, task, data)).map_err(|error| error.to_string())?;
    Ok(blake3::hash(canonical.as_bytes()).to_hex().chars().take(12).collect())
}

// Line and message in one line.
fn located(error: &toml::de::Error, text: &str) -> String {
    let line = error.span().map(|span| text.get(..span.start).unwrap_or_default().matches('\n').count() + 1);
    line.map_or_else(|| one_line(error), |line| format!("line {line}: {}", one_line(error)))
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEAD: &str = "name = \"x\"\ntask = \"pick_cube\"\n";
    const DATA: &str = "[data]\nexperts = 3\ncohorts = [{ agent = \"noise:1\", count = 2 }]\n";
    const STUDY: &str = "[[study]]\ntable = \"beta\"\n";

    #[test]
    fn the_committed_files_are_valid() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/experiments");
        for name in ["pick_cube", "stack_cube", "scorers", "arms", "chunks", "quick"] {
            let experiment = Experiment::read(&folder.join(name).with_extension("toml")).unwrap();
            assert!(!experiment.studies.is_empty(), "{name}");
        }
    }

    #[test]
    fn omitted_settings_have_their_defaults() {
        let experiment = Experiment::parse(&[HEAD, DATA, STUDY].concat()).unwrap();
        assert_eq!(experiment.recordings.config, SimConfig::default());
        assert_eq!(experiment.recordings.cohorts[1].name, "noise");
        assert_eq!(experiment.studies[0].name, "Quality score threshold β");
        assert!(experiment.task.starts_with("pick_cube_"), "{}", experiment.task);
    }

    #[test]
    fn the_name_of_recordings_depends_on_their_settings_only() {
        let key = |text: String| Experiment::parse(&text).unwrap().data_key;
        let plain = key([HEAD, DATA, STUDY].concat());
        assert_eq!(plain, key([HEAD, DATA, "[base]\nbeta = 0.5\n", STUDY].concat()));
        assert_ne!(plain, key([HEAD, &DATA.replace("count = 2", "count = 3"), STUDY].concat()));
    }

    #[test]
    fn errors_name_the_line_and_the_field() {
        let text = |base: &str, data: &str, study: &str| [HEAD, data, base, study].concat();
        for (file, parts) in [
            (text("[base]\nbetta = 1\n", DATA, STUDY), ["base: ", "unknown field `betta`"]),
            (text("[base]\nseeds = []\n", DATA, STUDY), ["base: seeds", "at least one"]),
            (text("", &DATA.replace("noise:1", "nose:1"), STUDY), ["data.cohorts[0].agent", "nose"]),
            (
                text("", &DATA.replace("{ agent", "{ name = \"expert\", agent"), STUDY),
                ["data.cohorts[0].name", "the name of the experts"],
            ),
            (
                text("", &DATA.replace("experts", "seed = 4294967296\nexperts"), STUDY),
                ["data.seed: ", "at most 4294967291"],
            ),
            (text("[base]\nseeds = [1, 4294967295]\n", DATA, STUDY), ["base: seeds: ", "4294967295 is too high"]),
            (text("", DATA, "[[study]]\ntable = \"gamma\"\n"), ["line 7", "unknown variant `gamma`"]),
            (text("", DATA, &[STUDY, STUDY].concat()), ["study \"Quality score", "duplicated"]),
            (
                text("", DATA, "[[study]]\ntable = \"beta\"\nset = { lambda = \"x\" }\n"),
                ["study \"Quality", "cell \"0\""],
            ),
        ] {
            let message = Experiment::parse(&file).unwrap_err();
            assert!(parts.iter().all(|part| message.contains(part)), "{message}");
        }
    }
}
