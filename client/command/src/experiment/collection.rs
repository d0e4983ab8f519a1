//! Collections of recordings: one for all seeds of an experiment, or one for each. On the server each is a task of its
//! own.
//!
//! Must not depend on a server.

use std::path::Path;

use gleaner_sim::Task;
use toml::Table;

use super::source::Source;

/// The setting of `[data]` that gives each seed recordings of its own.
const STRIDE: &str = "seed_stride";
/// The setting of `[data]` with the first recording's seed.
const SEED: &str = "seed";

/// Recordings, which cells learn from.
#[derive(Clone, Debug)]
pub(crate) struct Collection {
    pub(crate) source: Source,
    /// A digest of all that the recordings depend on.
    pub(crate) key: String,
    /// The task's name on the server: of these recordings alone, so that experiments with the same recordings share
    /// them and others do not mix theirs.
    pub(crate) task: String,
}

impl Collection {
    /// From the table `[data]`.
    ///
    /// # Errors
    /// The field, and what is wrong with it.
    pub(super) fn read(task: Option<Task>, data: &Table, beside: &Path) -> Result<Self, String> {
        let (source, key) = Source::read(task, data, beside)?;
        let task = format!("{}_{key}", source.task_name());
        Ok(Self { source, key, task })
    }
}

/// Takes `seed_stride` out of the table `[data]`; 0 without it.
///
/// # Errors
/// The field, and what is wrong with it.
pub(super) fn take_stride(data: &mut Table) -> Result<u64, String> {
    let stride = data.remove(STRIDE).map_or(Some(0), |value| value.as_integer());
    let stride = stride.and_then(|stride| u64::try_from(stride).ok());
    stride.ok_or_else(|| field("give a whole number, at least 0"))
}

fn field(problem: &str) -> String {
    format!("data.{STRIDE}: {problem}")
}

/// The table `[data]` with another seed of the first recording.
pub(super) fn with_seed(mut data: Table, seed: i64) -> Table {
    data.insert(SEED.to_owned(), seed.into());
    data
}

/// The recordings of every seed.
#[derive(Clone, Debug)]
pub(crate) struct Collections {
    /// The recordings from `data.seed` on. Collections differ in their recordings alone: cohorts and the task's spec of
    /// this one are those of each.
    first: Collection,
    /// For each seed its recordings; empty: all have the first.
    by_seed: Vec<(u64, Collection)>,
}

impl Collections {
    /// The first collection alone, or one for each of `seeds` if `stride` is above 0: seed S then has the recordings
    /// from `data.seed` + S × `stride` on, which `read` returns.
    ///
    /// # Errors
    /// The field, and what is wrong with it.
    pub(super) fn new(
        first: Collection,
        stride: u64,
        seeds: impl IntoIterator<Item = u64>,
        read: impl Fn(i64) -> Result<Collection, String>,
    ) -> Result<Self, String> {
        if stride == 0 {
            return Ok(Self { first, by_seed: Vec::new() });
        }
        let elsewhere = "the recordings of a folder are the same for every seed; leave it out";
        let set = first.source.simulated().ok_or_else(|| field(elsewhere))?;
        if stride < set.total() {
            let total = set.total();
            return Err(field(&format!("{stride} is less than the {total} recordings of a seed; give at least that")));
        }
        let (begin, mut by_seed) = (set.seed, Vec::new());
        for seed in seeds {
            if by_seed.iter().all(|(known, _)| *known != seed) {
                let begin = seed.checked_mul(stride).and_then(|offset| begin.checked_add(offset));
                let begin = begin.and_then(|begin| i64::try_from(begin).ok());
                let begin = begin.ok_or_else(|| field(&format!("{stride} times the seed {seed} is too high")))?;
                by_seed.push((seed, read(begin)?));
            }
        }
        Ok(Self { first, by_seed })
    }

    /// The recordings of a seed.
    pub(super) fn of(&self, seed: u64) -> &Collection {
        self.by_seed.iter().find(|(of, _)| *of == seed).map_or(&self.first, |(_, collection)| collection)
    }

    /// Every collection.
    pub(super) fn all(&self) -> Vec<&Collection> {
        let each: Vec<&Collection> = self.by_seed.iter().map(|(_, collection)| collection).collect();
        if each.is_empty() { vec![&self.first] } else { each }
    }

    /// What all have in common: the task's spec and name, the cohorts and their agents.
    pub(super) fn source(&self) -> &Source {
        &self.first.source
    }

    /// Puts another name in place of the task's, for a server without other recordings.
    ///
    /// # Errors
    /// Each seed has recordings of its own.
    pub(super) fn rename(&mut self, task: &str) -> Result<(), String> {
        if !self.by_seed.is_empty() {
            return Err(format!("data.{STRIDE}: there is one seed only; leave it out"));
        }
        task.clone_into(&mut self.first.task);
        Ok(())
    }
}

#[cfg(test)]
mod tests;
