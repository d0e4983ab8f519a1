//! One demonstration: its numbers at once, its pictures one step at a time.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use hdf5_pure::{AttrValue, Dataset, Error, File, FormatError, Group};
use serde_json::{Map, Value};

use super::entries::{Entry, Kind, is_number, kind};
use super::unfit;
use crate::problem::Problem;

/// Most bytes of a dataset that is read at once.
const MOST_BYTES: u64 = 1 << 30;
const NO_OBSERVATIONS: &str = "the demonstration has no observations; robomimic's `dataset_states_to_obs.py` adds them \
                               (to a file of robosuite after `convert_robosuite.py`)";

/// A demonstration, opened.
pub(super) struct Demo {
    path: PathBuf,
    name: String,
    group: Group,
    pub(super) steps: u64,
    pub(super) action_size: usize,
}

/// Values of every step beside observations and actions.
pub(super) struct Others {
    columns: Vec<(String, usize, Vec<f64>)>,
}

impl Demo {
    pub(super) fn open(path: &Path, file: &File, name: &str) -> Result<Self, Problem> {
        let damaged =
            |error: Error| unfit(path, &format!("{name}: {error}; the file is damaged or cut: copy it again"));
        let group = file.group(&format!("{}/{name}", super::DATA)).map_err(damaged)?;
        let actions = group.dataset("actions").map_err(damaged)?;
        let shape = actions.shape().map_err(damaged)?;
        let [steps, action_size] = shape.as_slice() else {
            return Err(unfit(path, &format!("{name}/actions has the shape {shape:?}, and needs steps × values")));
        };
        let (steps, action_size) = (*steps, usize::try_from(*action_size).unwrap_or(usize::MAX));
        Ok(Self { path: path.to_owned(), name: name.to_owned(), group, steps, action_size })
    }

    /// Its observations, sorted by name.
    pub(super) fn entries(&self) -> Result<Vec<Entry>, Problem> {
        let obs = match self.group.group("obs") {
            Ok(obs) => obs,
            // As robosuite records it: with states of the simulator alone.
            Err(Error::Format(FormatError::PathNotFound(_))) => return Err(self.wrong("obs", NO_OBSERVATIONS)),
            Err(error) => return Err(self.damaged("obs", &error)),
        };
        let mut keys = obs.datasets().map_err(|error| self.damaged("obs", &error))?;
        keys.sort();
        let mut entries = Vec::new();
        for key in keys {
            let place = format!("obs/{key}");
            let dataset = self.dataset(&place)?;
            let shape = dataset.shape().map_err(|error| self.damaged(&place, &error))?;
            let dtype = dataset.dtype().map_err(|error| self.damaged(&place, &error))?;
            let kind = kind(&shape, &dtype).map_err(|why| self.wrong(&place, &why))?;
            if shape.first() != Some(&self.steps) {
                let rows = shape.first().copied().unwrap_or_default();
                return Err(self.wrong(&place, &format!("it has {rows} rows, and there are {} actions", self.steps)));
            }
            entries.push(Entry { key, kind });
        }
        Ok(entries)
    }

    /// The demonstration must have the observations of the first one.
    pub(super) fn check(&self, wanted: &[Entry]) -> Result<(), Problem> {
        let found = self.entries()?;
        let differs = |entry: &&Entry| !found.contains(entry);
        match wanted.iter().find(differs).or_else(|| found.iter().find(|entry| !wanted.contains(entry))) {
            Some(entry) => {
                let problem =
                    "it is missing or has another shape or type than in the first demonstration; split the file";
                Err(self.wrong(&format!("obs/{}", entry.key), problem))
            }
            None => Ok(()),
        }
    }

    /// The values of every observation of numbers, each with its values a step.
    pub(super) fn numbers(&self, entries: &[Entry]) -> Result<Vec<(usize, Vec<f32>)>, Problem> {
        let numbers = entries.iter().filter_map(|entry| match entry.kind {
            Kind::Numbers(size) => Some((entry, size)),
            Kind::Color(..) | Kind::Depth(..) | Kind::Other(_) => None,
        });
        let read = |(entry, size): (&Entry, usize)| Ok((size, self.floats(&format!("obs/{}", entry.key))?));
        numbers.map(read).collect()
    }

    pub(super) fn actions(&self) -> Result<Vec<f32>, Problem> {
        self.floats("actions")
    }

    /// RGB of a step.
    pub(super) fn color(&self, key: &str, step: u64) -> Result<Vec<u8>, Problem> {
        let place = format!("obs/{key}");
        self.dataset(&place)?.read_u8_rows(step, 1).map_err(|error| self.damaged(&place, &error))
    }

    /// The metres of a step, as bytes.
    pub(super) fn depth(&self, key: &str, step: u64) -> Result<Vec<u8>, Problem> {
        let place = format!("obs/{key}");
        let metres = self.dataset(&place)?.read_f32_rows(step, 1).map_err(|error| self.damaged(&place, &error))?;
        Ok(metres.into_iter().flat_map(f32::to_le_bytes).collect())
    }

    /// The numbers beside observations: rewards, ends, states of the simulator, and the exact actions.
    pub(super) fn others(&self) -> Result<Others, Problem> {
        let mut names = self.group.datasets().map_err(|error| self.damaged("", &error))?;
        names.sort();
        let mut columns = Vec::new();
        for name in names {
            let dataset = self.dataset(&name)?;
            let shape = dataset.shape().map_err(|error| self.damaged(&name, &error))?;
            let number = dataset.dtype().map_err(|error| self.damaged(&name, &error)).map(|dtype| is_number(&dtype))?;
            if !number || shape.first() != Some(&self.steps) || shape.len() > 2 {
                continue;
            }
            self.check_size(&name, &dataset)?;
            let values = dataset.read_f64().map_err(|error| self.damaged(&name, &error))?;
            let size = shape.get(1).map_or(1, |size| usize::try_from(*size).unwrap_or(usize::MAX));
            columns.push((name, size, values));
        }
        Ok(Others { columns })
    }

    /// The names of numbers with one value a step.
    pub(super) fn single_columns(&self) -> Result<Vec<String>, Problem> {
        let columns = self.others()?.columns;
        Ok(columns.into_iter().filter(|(_, size, _)| *size == 1).map(|(name, ..)| name).collect())
    }

    pub(super) fn attrs(&self) -> Result<HashMap<String, AttrValue>, Problem> {
        self.group.attrs().map_err(|error| self.damaged("", &error))
    }

    fn floats(&self, place: &str) -> Result<Vec<f32>, Problem> {
        let dataset = self.dataset(place)?;
        self.check_size(place, &dataset)?;
        dataset.read_f32().map_err(|error| self.damaged(place, &error))
    }

    /// Sizes in the file are untrusted.
    fn check_size(&self, place: &str, dataset: &Dataset) -> Result<(), Problem> {
        let shape = dataset.shape().map_err(|error| self.damaged(place, &error))?;
        let bytes = shape.iter().fold(8, |bytes: u64, side| bytes.saturating_mul(*side));
        if bytes > MOST_BYTES {
            return Err(
                self.wrong(place, &format!("its numbers take more than {} MiB; split the file", MOST_BYTES >> 20))
            );
        }
        Ok(())
    }

    fn dataset(&self, place: &str) -> Result<Dataset, Problem> {
        self.group.dataset(place).map_err(|error| self.damaged(place, &error))
    }

    fn damaged(&self, place: &str, error: &Error) -> Problem {
        self.wrong(place, &format!("{error}; the file is damaged or cut: copy it again"))
    }

    fn wrong(&self, place: &str, problem: &str) -> Problem {
        unfit(&self.path, &format!("{}/{place}: {problem}", self.name))
    }
}

impl Others {
    /// The values of a step.
    pub(super) fn row(&self, step: u64) -> Map<String, Value> {
        let step = usize::try_from(step).unwrap_or(usize::MAX);
        let of = |(name, size, values): &(String, usize, Vec<f64>)| {
            let at = step.saturating_mul(*size);
            let row = values.get(at..at.saturating_add(*size)).unwrap_or_default();
            let value = if let [one] = row { (*one).into() } else { row.to_vec().into() };
            (name.clone(), value)
        };
        self.columns.iter().map(of).collect()
    }

    /// Whether the demonstration succeeded: by the last value of a column that was named, else by its rewards, where they
    /// are 0 and 1 alone.
    pub(super) fn success(&self, column: Option<&str>) -> Option<bool> {
        if let Some(column) = column {
            let (.., values) = self.columns.iter().find(|(name, ..)| name == column)?;
            return values.last().filter(|value| !value.is_nan()).map(|value| *value > 0.0);
        }
        let (_, _, rewards) = self.columns.iter().find(|(name, ..)| name == "rewards")?;
        let sparse = rewards.iter().all(|reward| *reward == 0.0 || *reward == 1.0);
        sparse.then(|| rewards.contains(&1.0))
    }
}
