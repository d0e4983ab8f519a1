//! The stages that cells are made of, each of them once: two cells whose stage is the same share it.
//!
//! A stage's key is a digest of all that it depends on, so that a later run finds the results of an earlier one.
//! Must not know a server.

use std::collections::HashMap;

use gleaner_core::schema::Problem;
use gleaner_core::selection::Selection;
use gleaner_core::{Device, EvaluateSpec, Values};
use serde::Serialize;

use super::attempts::Attempts;
use super::cell::{CellSettings, RuleSettings};
use super::file::Experiment;
use super::study::Cell;
use super::used::of_weighting;

// Changes when a stage's meaning does.
const FORMAT: &str = "gleaner-experiment/3";

/// What a stage does, with every setting that matters to it and no other. Settings are complete but for the device.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "stage", rename_all = "snake_case")]
pub(crate) enum Work {
    /// Makes nothing: the result exists already.
    Given {
        origin: Origin,
    },
    Snapshot {
        task: String,
        rule: RuleSettings,
    },
    Pretrain {
        settings: Values,
    },
    Score {
        settings: Values,
    },
    /// The marks of the recordings as scores.
    Marks,
    Dataset {
        selection: Selection,
    },
    Train {
        settings: Values,
    },
    Evaluate {
        settings: Values,
    },
    /// As `Evaluate`, by a command outside of the server.
    Attempts {
        attempts: Attempts,
        episodes: u32,
        seed: u64,
        hide_history: bool,
    },
}

impl Work {
    /// The stage's kind.
    pub(crate) fn kind(&self) -> &'static str {
        match self {
            Self::Given { origin: Origin::Snapshot(_) } | Self::Snapshot { .. } => "snapshot",
            Self::Given { origin: Origin::Encoder(_) } | Self::Pretrain { .. } => "pretrain",
            Self::Given { origin: Origin::Run(_) } | Self::Score { .. } | Self::Marks => "score",
            Self::Dataset { .. } => "dataset",
            Self::Train { .. } => "train",
            Self::Evaluate { .. } | Self::Attempts { .. } => "evaluate",
        }
    }
}

/// Where policies are evaluated.
#[derive(Clone, Copy, Debug)]
enum Place<'a> {
    /// In the embedded simulator, attempts of at most N steps.
    Simulator(u32),
    /// By a command.
    Elsewhere(&'a Attempts),
}

/// A result that exists before the first stage, by its id.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Origin {
    Snapshot(String),
    Encoder(String),
    /// A score run.
    Run(String),
}

impl Origin {
    /// The result's id.
    pub(super) fn id(&self) -> &str {
        match self {
            Self::Snapshot(id) | Self::Encoder(id) | Self::Run(id) => id,
        }
    }

    /// Whether the result takes the place of this work.
    fn replaces(&self, work: &Work) -> bool {
        match self {
            Self::Snapshot(_) => work.kind() == "snapshot",
            Self::Encoder(_) => ["snapshot", "pretrain"].contains(&work.kind()),
            Self::Run(_) => ["snapshot", "pretrain", "score"].contains(&work.kind()),
        }
    }
}

/// One stage: its work, and the stage whose result it works on.
#[derive(Clone, Debug)]
pub(crate) struct Stage {
    pub(crate) key: String,
    /// The server's task, by its name or id.
    pub(crate) task: String,
    pub(crate) work: Work,
    pub(crate) input: Option<usize>,
    /// The first cell that needs it.
    pub(crate) label: String,
}

/// The stages of one cell under one seed, as indices.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Chain {
    pub(crate) seed: u64,
    /// All of them, each after its input.
    pub(crate) stages: Vec<usize>,
}

/// Every stage of an experiment, each after its input.
#[derive(Debug, Default)]
pub(crate) struct Graph {
    pub(crate) stages: Vec<Stage>,
    /// For each study, for each cell, for each seed.
    pub(crate) chains: Vec<Vec<Vec<Chain>>>,
    by_key: HashMap<String, usize>,
    device: Device,
    evaluates: bool,
}

impl Graph {
    pub(crate) fn new(experiment: &Experiment, device: Device) -> Self {
        Self { device, evaluates: true, ..Self::default() }.filled(experiment)
    }

    /// Every stage up to the policies, for callers that evaluate them without a job.
    pub(super) fn without_evaluations(experiment: &Experiment, device: Device) -> Self {
        Self { device, ..Self::default() }.filled(experiment)
    }

    /// The stages of cells on results that exist, one for each seed: the seeds are 0 and up. A cell of `runs` begins with
    /// the score run of this id instead. `max_steps` limits the attempts of evaluations; without it policies are trained
    /// and not evaluated.
    pub(super) fn on_results(
        task: &str,
        (cells, runs): (&[Cell], &[Option<String>]),
        origins: &[Origin],
        max_steps: Option<u32>,
        device: Device,
    ) -> Self {
        let mut graph = Self { device, evaluates: max_steps.is_some(), ..Self::default() };
        let mut chains = vec![Vec::new(); cells.len()];
        for (seed, origin) in (0..).zip(origins) {
            for (at, (cell, of_cell)) in cells.iter().zip(&mut chains).enumerate() {
                let run = runs.get(at).cloned().flatten();
                let origin = &run.map_or_else(|| origin.clone(), Origin::Run);
                let rest = works(task, Place::Simulator(max_steps.unwrap_or_default()), &cell.settings, seed);
                let rest = rest.into_iter().filter(|work| !origin.replaces(work));
                let works = std::iter::once(Work::Given { origin: origin.clone() }).chain(rest);
                of_cell.push(graph.chain(task, works, seed, &format!("{}, seed {seed}", cell.label)));
            }
        }
        graph.chains = vec![chains];
        graph
    }

    fn filled(mut self, experiment: &Experiment) -> Self {
        let graph = &mut self;
        let max_steps = experiment.recordings.source().simulated().map_or(0, |set| set.config.max_steps);
        let place = experiment.attempts.as_ref().map_or(Place::Simulator(max_steps), Place::Elsewhere);
        // Seed by seed, so that the first seed of everything is there before the second of anything.
        let mut chains: Vec<Vec<Vec<Chain>>> =
            experiment.studies.iter().map(|study| vec![Vec::new(); study.cells.len()]).collect();
        let most = experiment.studies.iter().flat_map(|study| &study.cells).map(|cell| cell.settings.seeds.len()).max();
        for nth in 0..most.unwrap_or(0) {
            for (study, of_study) in experiment.studies.iter().zip(&mut chains) {
                for (cell, of_cell) in study.cells.iter().zip(of_study) {
                    let Some(&seed) = cell.settings.seeds.get(nth) else { continue };
                    let label = format!("{}, {}, seed {seed}", study.name, cell.label);
                    let task = &experiment.recordings.of(seed).task;
                    let works = works(task, place, &cell.settings, seed);
                    of_cell.push(graph.chain(task, works, seed, &label));
                }
            }
        }
        self.chains = chains;
        self
    }

    /// The stage of this kind in a chain.
    pub(super) fn find(&self, chain: &Chain, kind: &str) -> Option<usize> {
        chain.stages.iter().copied().find(|&index| self.stages[index].work.kind() == kind)
    }

    fn chain(&mut self, task: &str, works: impl IntoIterator<Item = Work>, seed: u64, label: &str) -> Chain {
        let mut stages = Vec::new();
        for work in works {
            if self.evaluates || work.kind() != "evaluate" {
                let index = self.stage(task, work, stages.last().copied(), label);
                stages.push(index);
            }
        }
        Chain { seed, stages }
    }

    fn stage(&mut self, task: &str, work: Work, input: Option<usize>, label: &str) -> usize {
        let input_key = input.map(|input| self.stages[input].key.as_str()).unwrap_or_default();
        // A Work holds numbers, words and lists of them: it always has a JSON form.
        let canonical = serde_json::to_string(&(FORMAT, self.device, &keyed(&work), input_key)).unwrap_or_default();
        let key = blake3::hash(canonical.as_bytes()).to_hex().to_string();
        if let Some(&there) = self.by_key.get(&key) {
            return there;
        }
        let index = self.stages.len();
        self.by_key.insert(key.clone(), index);
        self.stages.push(Stage { key, task: task.to_owned(), work, input, label: label.to_owned() });
        index
    }
}

// What the key of a work is made of. A setting at the value that earlier versions used is left out, so that their stages
// keep their keys.
fn keyed(work: &Work) -> Work {
    let mut keyed = work.clone();
    if let Work::Pretrain { settings } = &mut keyed {
        settings.retain(|name, value| name != "validation_share" || value.as_f64() != Some(0.0));
    }
    if let Work::Train { settings } = &mut keyed {
        settings.retain(|name, value| name != "hidden_history" || *value != "steps");
        settings.retain(|name, value| name != "switch_weight" || value.as_f64() != Some(1.0));
        for off in ["dropout", "fresh_share"] {
            settings.retain(|name, value| name != off || value.as_f64() != Some(0.0));
        }
    }
    if let Work::Score { settings } = &mut keyed {
        settings.retain(|name, value| name != "lead_in" || value.as_f64() != Some(0.0));
        settings.retain(|name, value| name != "progress" || *value != "furthest");
        settings.retain(|name, value| name != "earliness" || value.as_f64() != Some(0.0));
    }
    keyed
}

// A cell's works, each on the result of the one before. The cell has been checked, so every spec is sound.
fn works(task: &str, place: Place<'_>, cell: &CellSettings, seed: u64) -> Vec<Work> {
    let cell = &cell.used();
    let mut works = vec![Work::Snapshot { task: task.to_owned(), rule: cell.rule.of(seed) }];
    if cell.pretrains() {
        works.push(Work::Pretrain { settings: complete(cell.pretrain_spec(seed).map(|spec| spec.values())) });
    }
    if cell.oracle {
        works.push(Work::Marks);
    } else if cell.method.gleans {
        works.push(Work::Score { settings: complete(cell.score_spec(seed).map(|spec| spec.values())) });
    }
    if !cell.evaluate {
        return works;
    }
    if cell.method.gleans {
        works.push(Work::Dataset { selection: cell.selection().unwrap_or(Selection::beta(cell.beta())) });
    }
    let mut settings = complete(cell.train_spec(seed).map(|spec| spec.values()));
    if !cell.method.gleans {
        settings.retain(|name, _| !of_weighting(name));
    }
    works.push(Work::Train { settings });
    let CellSettings { episodes, hide_history, .. } = *cell;
    works.push(match place {
        Place::Simulator(max_steps) => {
            let trials =
                EvaluateSpec { episodes, max_steps, seeds: vec![seed], hide_history, ..EvaluateSpec::default() };
            let mut settings = complete(Ok(trials.values()));
            settings.remove("simulation");
            Work::Evaluate { settings }
        }
        Place::Elsewhere(attempts) => Work::Attempts { attempts: attempts.clone(), episodes, seed, hide_history },
    });
    works
}

// Without the device, which is part of every key already.
fn complete(values: Result<Values, Problem>) -> Values {
    let mut values = values.unwrap_or_default();
    values.remove("device");
    values
}

#[cfg(test)]
mod tests;
