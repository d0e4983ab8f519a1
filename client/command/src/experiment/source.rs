//! Where an experiment's recordings come from: the embedded simulator, or a folder of recordings made elsewhere.
//!
//! Must not depend on a server.

mod folder;
mod simulated;

use std::path::Path;

use gleaner_core::TaskSpec;
use gleaner_sim::{AgentKind, Task};
use toml::Table;

pub(crate) use folder::Folder;

use super::study::one_line;
use crate::cmd::record::RecordSet;

/// The setting with the path of a folder.
const FOLDER: &str = "folder";

/// The recordings of an experiment.
#[derive(Clone, Debug)]
pub(crate) enum Source {
    Simulated(RecordSet),
    Folder(Box<Folder>),
}

impl Source {
    /// From the table `[data]`, with a digest of all that the recordings depend on. `beside` is the folder that paths in
    /// the file are relative to.
    ///
    /// # Errors
    /// The field, and what is wrong with it.
    pub(super) fn read(task: Option<Task>, data: &Table, beside: &Path) -> Result<(Self, String), String> {
        if data.contains_key(FOLDER) {
            if task.is_some() {
                return Err("task: data.folder has the task's spec; leave task out".into());
            }
            let (folder, key) = Folder::read(&settings(data)?, beside).map_err(|problem| format!("data.{problem}"))?;
            return Ok((Self::Folder(Box::new(folder)), key));
        }
        let task = task.ok_or("task: give the simulator's task, or data.folder with recordings made elsewhere")?;
        let (set, key) = simulated::read(task, &settings(data)?)?;
        Ok((Self::Simulated(set), key))
    }

    /// The name of the task.
    pub(super) fn task_name(&self) -> &str {
        match self {
            Self::Simulated(set) => set.task.name(),
            Self::Folder(folder) => &folder.spec.name,
        }
    }

    /// The task; an experiment has it under a name of its own.
    pub(super) fn spec(&self) -> TaskSpec {
        match self {
            Self::Simulated(set) => gleaner_sim::task_spec(set.task, &set.config),
            Self::Folder(folder) => folder.spec.clone(),
        }
    }

    /// The name of the experts' cohort.
    pub(super) fn experts(&self) -> &str {
        match self {
            Self::Simulated(_) => AgentKind::Expert.name(),
            Self::Folder(folder) => &folder.experts,
        }
    }

    /// The imperfect cohorts' names.
    pub(super) fn imperfect(&self) -> Vec<&str> {
        match self {
            Self::Simulated(set) => set.cohorts.iter().skip(1).map(|cohort| cohort.name.as_str()).collect(),
            Self::Folder(folder) => folder.imperfect.iter().map(String::as_str).collect(),
        }
    }

    /// Every cohort with the agent that recorded it, experts first.
    pub(super) fn agents(&self) -> Vec<(&str, String)> {
        match self {
            Self::Simulated(set) => {
                set.cohorts.iter().map(|cohort| (cohort.name.as_str(), cohort.agent.to_string())).collect()
            }
            Self::Folder(folder) => std::iter::once(folder.experts.as_str())
                .chain(self.imperfect())
                .map(|cohort| (cohort, String::new()))
                .collect(),
        }
    }

    /// Whether it is known from which step on each recording went wrong.
    pub(super) fn is_marked(&self) -> bool {
        match self {
            Self::Simulated(_) => true,
            Self::Folder(folder) => folder.is_marked,
        }
    }

    /// The recordings of the simulator.
    pub(super) fn simulated(&self) -> Option<&RecordSet> {
        match self {
            Self::Simulated(set) => Some(set),
            Self::Folder(_) => None,
        }
    }
}

/// Puts another folder in place of the one that `[data]` names.
pub(super) fn replace_folder(data: &mut Table, folder: &Path) -> Result<(), String> {
    if !data.contains_key(FOLDER) {
        return Err("--recordings: the file's recordings are of the simulator; leave the flag out".into());
    }
    // Relative to the current folder, as on every command line.
    let folder = std::path::absolute(folder).map_err(|error| format!("--recordings: {error}"))?;
    let text = folder.to_str().ok_or_else(|| format!("--recordings: {} is not UTF-8", folder.display()))?;
    data.insert(FOLDER.to_owned(), text.into());
    Ok(())
}

fn settings<T: serde::de::DeserializeOwned>(data: &Table) -> Result<T, String> {
    data.clone().try_into().map_err(|error: toml::de::Error| format!("data: {}", one_line(&error)))
}

// Short, because it is part of a task's name.
fn digest(hash: blake3::Hash) -> String {
    hash.to_hex().chars().take(12).collect()
}

#[cfg(test)]
mod tests;
