//! The tasks that datasets may be added to, and what keeps a dataset from one.

use std::path::Path;

use gleaner_core::proto::task::spec_from_proto;
use gleaner_proto::v1::Task;
use gleaner_recording::TaskSpec;

use crate::failure::{Failure, Result};
use crate::intake::Intake;

/// The part by which rates differ at most.
const RATE: f64 = 0.05;

/// A task that a dataset may be added to.
pub(super) struct Known {
    pub(super) spec: TaskSpec,
    /// Episodes that it has already; `None` if it is of another dataset of this push and will be created.
    pub(super) episodes: Option<u64>,
}

impl Known {
    /// A task of the server; `None` if its spec cannot be read here.
    pub(super) fn of(task: Task) -> Option<Self> {
        let episodes = task.success_count + task.failure_count + task.unknown_count;
        Some(Self { spec: spec_from_proto(task.spec?).ok()?, episodes: Some(episodes) })
    }

    /// The note that a dataset is added to the task of its name, or of that of its environment.
    pub(super) fn addition(&self, path: &Path, of_environment: bool) -> String {
        let (path, name) = (path.display(), &self.spec.name);
        let its = if of_environment { "the name of its environment" } else { "its name" };
        match self.episodes {
            Some(episodes) => {
                format!("{path} is added to the existing task {name}, which has {its} and {episodes} episodes already")
            }
            None => format!("{path} is added to the task {name} that this push creates, which has {its}"),
        }
    }
}

pub(super) fn near(rate: f64, other: f64) -> bool {
    (rate - other).abs() <= RATE * rate
}

/// Refuses a dataset of another rate than the task of its name: its steps would be sampled at that of the task.
pub(super) fn same_rate(dataset: &Intake, known: &TaskSpec) -> Result<()> {
    let (path, name) = (dataset.path.display(), &known.name);
    let (rate, theirs) = (dataset.description.spec.rate_hz, known.rate_hz);
    if near(rate, theirs) {
        return Ok(());
    }
    Err(Failure::message(if dataset.description.rate_stated {
        format!(
            "{path} has {rate} steps per second and the task {name} {theirs}: correct the rate, or add --task {name} to \
             sample the episodes at that of the task"
        )
    } else {
        format!(
            "{path} does not state its rate, and the task {name} has {theirs} steps per second: add --rate {theirs}"
        )
    }))
}

/// Whether two tasks may have one instruction; one that is not stated agrees with any.
pub(super) fn agree(drafted: &TaskSpec, known: &TaskSpec) -> bool {
    let (ours, theirs) = (drafted.instruction.trim(), known.instruction.trim());
    ours.is_empty() || theirs.is_empty() || ours == theirs
}

/// Refuses a dataset of another instruction than the task of its name: with `--task` it is added on purpose.
pub(super) fn same_instruction(path: &Path, drafted: &TaskSpec, known: &TaskSpec) -> Result<()> {
    if agree(drafted, known) {
        return Ok(());
    }
    let (path, name) = (path.display(), &known.name);
    let (ours, theirs) = (drafted.instruction.trim(), known.instruction.trim());
    Err(Failure::message(format!(
        "{path} would be added to the task {name}, but its instruction is {ours:?} and that of the task {theirs:?}: add \
         --task {name} to add it on purpose, or make a task for it with `gleaner task draft {path} --name NAME > task.toml` \
         and `gleaner task create task.toml`, and push it with --task and that task's name"
    )))
}

#[cfg(test)]
mod tests {
    use gleaner_core::proto::task::spec_to_proto;

    use super::*;

    fn spec(name: &str, instruction: &str) -> TaskSpec {
        let spec = serde_json::json!({ "name": name, "instruction": instruction, "rate_hz": 10.0, "action": [] });
        serde_json::from_value(spec).unwrap()
    }

    #[test]
    fn a_dataset_of_another_instruction_is_not_added_to_a_task_unasked() {
        let problem = |drafted: &TaskSpec, known: TaskSpec| {
            same_instruction(Path::new("x/kitchen"), drafted, &known).err().map(|error| error.to_string())
        };
        let drafted = spec("kitchen", "stack the cups");
        for other in ["", "stack the cups", " stack the cups "] {
            assert_eq!(problem(&drafted, spec("kitchen", other)), None, "{other:?}");
        }
        assert_eq!(problem(&spec("kitchen", ""), spec("kitchen", "wash up")), None);
        let named = problem(&drafted, spec("kitchen", "wash up")).unwrap();
        for part in ["x/kitchen", "\"stack the cups\"", "\"wash up\": add --task kitchen to add", "--name NAME"] {
            assert!(named.contains(part), "{part}: {named}");
        }
    }

    #[test]
    fn the_note_on_an_addition_names_the_task_and_its_reason() {
        let note = |episodes, of_environment| {
            Known { spec: spec("Lift", ""), episodes }.addition(Path::new("x/b.hdf5"), of_environment)
        };
        let existing = "x/b.hdf5 is added to the existing task Lift, which has its name and 2 episodes already";
        assert_eq!(note(Some(2), false), existing);
        assert_eq!(note(Some(2), true), existing.replace("its name", "the name of its environment"));
        let created =
            "x/b.hdf5 is added to the task Lift that this push creates, which has the name of its environment";
        assert_eq!(note(None, true), created);
        assert_eq!(note(None, false), created.replace("the name of its environment", "its name"));
    }

    #[test]
    fn a_known_task_has_the_episodes_of_every_outcome() {
        let task = Task {
            spec: Some(spec_to_proto(spec("kitchen", "wash up"))),
            success_count: 3,
            failure_count: 2,
            unknown_count: 1,
            ..Task::default()
        };
        let known = Known::of(task).unwrap();
        assert_eq!((known.spec.name.as_str(), known.episodes), ("kitchen", Some(6)));
        assert!(Known::of(Task::default()).is_none());
    }
}
