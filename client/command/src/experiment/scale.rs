//! The section `[scale]` of an experiment's file: sizes for a larger machine, which `--scale` lays over the base and the
//! data. What a study or a cell sets itself still wins.
//!
//! Must not depend on a server.

use gleaner_core::{Device, Precision, Preset, Values, Words as _};
use serde::{Deserialize, Serialize};
use toml::{Table, Value};

use super::grid::set;
use super::study::Cell;

/// Jobs with settings of their own.
const JOBS: [&str; 2] = ["pretrain", "train"];

/// Which sizes an experiment runs with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Sizes {
    /// Those of the base and the data.
    #[default]
    Base,
    /// Those of the section `[scale]` over them.
    Scaled,
}

impl Sizes {
    /// With the flag of the command line.
    pub(crate) fn of_flag(scale: bool) -> Self {
        if scale { Self::Scaled } else { Self::Base }
    }
}

/// The section as it is written; what is left out stays as it is.
#[derive(Clone, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct Scale {
    /// Device of the jobs, unless the command line names one.
    pub(super) device: Option<Device>,
    /// Size of the models.
    preset: Option<Preset>,
    /// Precision of pretraining and training.
    precision: Option<Precision>,
    /// Camera height and width of the simulator's recordings, in pixels.
    image: Option<u32>,
    seeds: Option<Vec<u32>>,
    /// Evaluation episodes for each seed.
    episodes: Option<u32>,
    pretrain: Steps,
    train: Steps,
    /// Of the rule that selects episodes.
    rule: Experts,
    /// Of the simulator's recordings.
    data: Experts,
}

/// Sizes of one kind of job.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Steps {
    steps: Option<u32>,
    batch: Option<u32>,
}

impl Steps {
    fn sizes(self) -> [(&'static str, Option<u32>); 2] {
        [("steps", self.steps), ("batch", self.batch)]
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Experts {
    experts: Option<u32>,
}

impl Scale {
    /// Lays the sizes over `[data]` and `[base]`.
    ///
    /// # Errors
    /// The field, and what is wrong with it.
    pub(super) fn apply(&self, data: &mut Table, base: &mut Table, is_simulated: bool) -> Result<(), String> {
        if *self == Self::default() {
            return Err("scale: the section is empty; give at least one size".into());
        }
        for (field, key, size) in [("image", "image", self.image), ("data.experts", "experts", self.data.experts)] {
            let Some(size) = size else { continue };
            if !is_simulated {
                return Err(format!("scale.{field}: the recordings of a folder exist already; leave it out"));
            }
            data.insert(key.to_owned(), size.into());
        }
        let word = |key: &str, word: Option<&'static str>| word.map(|word| (key.to_owned(), Value::from(word)));
        let words =
            [word("preset", self.preset.map(Preset::as_str)), word("precision", self.precision.map(Precision::as_str))];
        for (key, value) in words.into_iter().flatten() {
            // A job's own value in the base would win over the one of all jobs.
            for job in JOBS {
                if let Some(settings) = base.get_mut(job).and_then(Value::as_table_mut) {
                    settings.remove(&key);
                }
            }
            base.insert(key, value);
        }
        if let Some(seeds) = &self.seeds {
            base.insert("seeds".to_owned(), seeds.clone().into());
        }
        let numbers = [("episodes".to_owned(), self.episodes), ("rule.experts".to_owned(), self.rule.experts)];
        let of_jobs = self.of_jobs().map(|(job, key, size)| (format!("{job}.{key}"), size));
        for (key, size) in numbers.into_iter().chain(of_jobs) {
            if let Some(size) = size {
                set(base, &key, size.into()).map_err(|problem| format!("base.{problem}"))?;
            }
        }
        Ok(())
    }

    /// Fails if a cell sets steps or a batch for all jobs, which the sizes of a single job would hide. `base` has the
    /// settings that the file's base has for all jobs.
    pub(super) fn check(&self, base: &Table, cell: &Cell) -> Result<(), String> {
        let settings = &cell.settings;
        for (job, key, size) in self.of_jobs() {
            let of_job: &Values = if job == "train" { &settings.train } else { &settings.pretrain };
            let is_scaled = size.is_some() && of_job.get(key).cloned() == size.map(Into::into);
            let of_base = base.get(key).and_then(|value| serde_json::to_value(value).ok());
            if is_scaled && settings.settings.get(key) != of_base.as_ref() {
                return Err(format!(
                    "cell {:?}: {key}: scale.{job}.{key} would win over it; name it {job}.{key} here",
                    cell.label
                ));
            }
        }
        Ok(())
    }

    /// Each job with its sizes.
    fn of_jobs(&self) -> impl Iterator<Item = (&'static str, &'static str, Option<u32>)> {
        let jobs = JOBS.into_iter().zip([self.pretrain, self.train]);
        jobs.flat_map(|(job, steps)| steps.sizes().map(|(key, size)| (job, key, size)))
    }
}

#[cfg(test)]
pub(super) mod tests;
