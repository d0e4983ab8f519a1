//! The experiment file: the recordings, the base that all cells share, the studies, and sizes for a larger machine.

use std::path::Path;

use gleaner_client::ClientError;
use gleaner_core::Device;
use gleaner_sim::Task;
use serde::Deserialize;
use toml::Table;

use super::attempts::Attempts;
use super::collection::{Collection, Collections, take_stride, with_seed};
use super::scale::{Scale, Sizes};
use super::source::{self, Source};
use super::study::{Cell, StudySettings, TableKind, one_line};
use crate::failure::{Failure, Result};

/// The file as it is written.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ExperimentFile {
    name: String,
    #[serde(default)]
    task: Option<Task>,
    data: Table,
    #[serde(default)]
    attempts: Option<Attempts>,
    #[serde(default)]
    base: Table,
    #[serde(default)]
    scale: Option<Scale>,
    study: Vec<StudySettings>,
}

/// An experiment that can be run: every field is checked.
#[derive(Clone, Debug)]
pub(crate) struct Experiment {
    pub(crate) name: String,
    pub(crate) recordings: Collections,
    /// What evaluates policies, if the embedded simulator does not.
    pub(crate) attempts: Option<Attempts>,
    pub(crate) studies: Vec<Study>,
    pub(crate) sizes: Sizes,
    /// Of the jobs, unless the command line names one.
    pub(crate) device: Device,
}

/// A study with its cells.
#[derive(Clone, Debug)]
pub(crate) struct Study {
    pub(crate) name: String,
    pub(crate) table: TableKind,
    pub(crate) cells: Vec<Cell>,
}

impl Experiment {
    /// From a file, with another folder of recordings if one is given. Errors name the study, cell and field.
    pub(crate) fn read(path: &Path, recordings: Option<&Path>, sizes: Sizes) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(ClientError::io(path))?;
        let beside = path.parent().unwrap_or_else(|| Path::new(""));
        let parsed = toml::from_str(&text).map_err(|error| located(&error, &text));
        let checked = parsed.and_then(|mut file: ExperimentFile| {
            if let Some(folder) = recordings {
                source::replace_folder(&mut file.data, folder)?;
            }
            Self::checked(file, beside, sizes)
        });
        checked.map_err(|problem| Failure::message(format!("{}: {problem}", path.display())))
    }

    /// From the content of a file without paths.
    #[cfg(test)]
    pub(crate) fn parse(text: &str) -> std::result::Result<Self, String> {
        Self::parse_with(text, Sizes::Base)
    }

    #[cfg(test)]
    pub(super) fn parse_with(text: &str, sizes: Sizes) -> std::result::Result<Self, String> {
        Self::checked(toml::from_str(text).map_err(|error| located(&error, text))?, Path::new(""), sizes)
    }

    /// From the parsed content of a file without paths.
    pub(super) fn from_table(table: Table) -> std::result::Result<Self, String> {
        let file = table.try_into().map_err(|error: toml::de::Error| one_line(&error))?;
        Self::checked(file, Path::new(""), Sizes::Base)
    }

    fn checked(file: ExperimentFile, beside: &Path, sizes: Sizes) -> std::result::Result<Self, String> {
        let experiment = Self::built(&file, beside, None)?;
        let Some(scale) = &file.scale else {
            let lacking =
                "--scale: the file has no section [scale]; add one with the larger sizes, or leave the flag out";
            return if sizes == Sizes::Base { Ok(experiment) } else { Err(lacking.into()) };
        };
        // Without --scale too, so that a mistake is found before a larger machine runs the file.
        let scaled = experiment.scaled(&file, scale, beside)?;
        Ok(if sizes == Sizes::Base { experiment } else { scaled })
    }

    /// The same file with the sizes of its section `[scale]`.
    fn scaled(&self, file: &ExperimentFile, scale: &Scale, beside: &Path) -> std::result::Result<Self, String> {
        let (mut larger, source) = (file.clone(), self.recordings.source());
        let is_simulated = source.simulated().is_some();
        scale.apply(&mut larger.data, &mut larger.base, is_simulated)?;
        // The digest of a folder takes a while, and no size changes it.
        let folder = (!is_simulated).then(|| self.recordings.of(0).clone());
        let here = |problem: String| format!("with [scale]: {problem}");
        let scaled = Self::built(&larger, beside, folder).map_err(here)?;
        for study in &scaled.studies {
            let checked = study.cells.iter().try_for_each(|cell| scale.check(&file.base, cell));
            checked.map_err(|problem| format!("study {:?}: {problem}", study.name))?;
        }
        Ok(Self { sizes: Sizes::Scaled, device: scale.device.unwrap_or_default(), ..scaled })
    }

    /// With the sizes of the base. `folder` is the folder of recordings, if it has been read.
    fn built(file: &ExperimentFile, beside: &Path, folder: Option<Collection>) -> std::result::Result<Self, String> {
        let mut data = file.data.clone();
        let stride = take_stride(&mut data)?;
        let first = folder.map_or_else(|| Collection::read(file.task, &data, beside), Ok)?;
        let source = &first.source;
        let names = source.imperfect();
        if let Some(attempts) = &file.attempts {
            attempts.check().map_err(|problem| format!("attempts.{problem}"))?;
            if source.simulated().is_some() {
                return Err("attempts: the simulator of the task evaluates; leave the table out".into());
            }
        }
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
            if let Some(problem) = cells.iter().find_map(|cell| impossible(cell, source, file.attempts.is_some())) {
                return Err(format!("study {name:?}: {problem}"));
            }
            if studies.iter().any(|other| other.name == name) {
                return Err(format!("study {name:?}: the name is duplicated; rename one"));
            }
            studies.push(Study { name, table: study.table, cells });
        }
        let cells = studies.iter().flat_map(|study| &study.cells);
        let seeds: Vec<u64> = cells.flat_map(|cell| cell.settings.seeds.clone()).collect();
        let of_seed = |seed| Collection::read(file.task, &with_seed(data.clone(), seed), beside);
        let recordings = Collections::new(first, stride, seeds, of_seed)?;
        let (name, attempts) = (file.name.clone(), file.attempts.clone());
        Ok(Self { name, recordings, attempts, studies, sizes: Sizes::Base, device: Device::default() })
    }
}

/// What these recordings do not allow.
fn impossible(cell: &Cell, source: &Source, has_attempts: bool) -> Option<String> {
    let label = &cell.label;
    if cell.settings.evaluate && source.simulated().is_none() && !has_attempts {
        return Some(format!(
            "cell {label:?}: evaluate: no simulator is known for these recordings; give [attempts], or evaluate = false"
        ));
    }
    (cell.settings.oracle && !source.is_marked())
        .then(|| format!("cell {label:?}: oracle: the recordings have no marks"))
}

// Line and message in one line.
fn located(error: &toml::de::Error, text: &str) -> String {
    let line = error.span().map(|span| text.get(..span.start).unwrap_or_default().matches('\n').count() + 1);
    line.map_or_else(|| one_line(error), |line| format!("line {line}: {}", one_line(error)))
}

#[cfg(test)]
mod tests {
    use gleaner_sim::SimConfig;

    use super::*;

    const HEAD: &str = "name = \"x\"\ntask = \"pick_cube\"\n";
    const DATA: &str = "[data]\nexperts = 3\ncohorts = [{ agent = \"noise:1\", count = 2 }]\n";
    const STUDY: &str = "[[study]]\ntable = \"beta\"\n";

    #[test]
    fn the_committed_files_are_valid() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/experiments");
        let elsewhere = crate::experiment::scale::tests::folder();
        let mut count = 0;
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.extension().is_some_and(|extension| extension == "toml") {
                let is_folder = std::fs::read_to_string(&path).unwrap().contains("\nfolder = ");
                let recordings = is_folder.then_some(elsewhere.path());
                let experiment = Experiment::read(&path, recordings, Sizes::Base).unwrap();
                assert!(!experiment.studies.is_empty(), "{}", path.display());
                count += 1;
            }
        }
        assert!(count > 20, "{count} files");
    }

    #[test]
    fn omitted_settings_have_their_defaults() {
        let experiment = Experiment::parse(&[HEAD, DATA, STUDY].concat()).unwrap();
        assert_eq!(experiment.recordings.source().simulated().unwrap().config, SimConfig::default());
        assert_eq!(experiment.recordings.source().imperfect(), ["noise"]);
        assert_eq!(experiment.studies[0].name, "Quality score threshold β");
        let task = &experiment.recordings.of(0).task;
        assert!(task.starts_with("pick_cube_"), "{task}");
    }

    #[test]
    fn the_name_of_recordings_depends_on_their_settings_only() {
        let key = |text: String| Experiment::parse(&text).unwrap().recordings.of(0).key.clone();
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
