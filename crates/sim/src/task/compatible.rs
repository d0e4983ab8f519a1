//! Whether the task of recordings can be simulated. This module does not depend on worlds or agents.

use gleaner_recording::{CameraSpec, FieldSpec, TaskSpec};

use super::{Task, task_spec};
use crate::config::SimConfig;
use crate::error::SimError;

/// Finds the simulated task with the name of a specification, and the settings that give its observations and actions.
/// The step limit is the default.
///
/// # Errors
/// [`SimError::UnknownTask`] if no simulated task has this name, [`SimError::Incompatible`] as in
/// [`compatible_with`].
pub fn compatible(spec: &TaskSpec) -> Result<(Task, SimConfig), SimError> {
    let task: Task = spec.name.parse()?;
    Ok((task, compatible_with(task, spec)?))
}

/// The simulator's task of that name, or of the specification's own if it is empty, with its settings for this
/// specification.
///
/// # Errors
/// As [`compatible`].
pub fn simulated(spec: &TaskSpec, simulation: &str) -> Result<(Task, SimConfig), SimError> {
    if simulation.is_empty() {
        return compatible(spec);
    }
    let task: Task = simulation.parse()?;
    Ok((task, compatible_with(task, spec)?))
}

/// The settings with which a simulated task has the observations and actions of a specification with any name. The step
/// limit is the default.
///
/// # Errors
/// [`SimError::Incompatible`] names the first field that differs from the simulated task, and the fix;
/// [`SimError::Config`] if the simulator does not support the image size.
pub fn compatible_with(task: Task, spec: &TaskSpec) -> Result<SimConfig, SimError> {
    let config = match spec.cameras.first() {
        Some(camera) => SimConfig { image: camera.height, ..SimConfig::default() },
        None => SimConfig::default(),
    };
    config.validate()?;
    let simulated = task_spec(task, &config);
    let differ = |field: &'static str, given: String, wanted: String| -> Result<(), SimError> {
        if given == wanted { Ok(()) } else { Err(SimError::Incompatible { task: task.name(), field, given, wanted }) }
    };
    differ("cameras", cameras(&spec.cameras), cameras(&simulated.cameras))?;
    differ("proprioception", fields(&spec.proprioception), fields(&simulated.proprioception))?;
    differ("action", fields(&spec.action), fields(&simulated.action))?;
    differ("rate_hz", spec.rate_hz.to_string(), simulated.rate_hz.to_string())?;
    Ok(config)
}

fn cameras(list: &[CameraSpec]) -> String {
    let camera = |camera: &CameraSpec| {
        let depth = if camera.depth { " with depth" } else { "" };
        format!("{} {}x{}{depth}", camera.name, camera.height, camera.width)
    };
    listed(list.iter().map(camera))
}

fn fields(list: &[FieldSpec]) -> String {
    listed(list.iter().map(|field| format!("{} {}", field.name, field.size)))
}

fn listed(items: impl Iterator<Item = String>) -> String {
    format!("[{}]", items.collect::<Vec<_>>().join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stacking(image: u32) -> TaskSpec {
        task_spec(Task::StackCube, &SimConfig { image, ..SimConfig::default() })
    }

    #[test]
    fn own_specification_is_compatible() {
        for task in Task::ALL {
            let config = SimConfig { image: 48, ..SimConfig::default() };
            assert_eq!(compatible(&task_spec(task, &config)).unwrap(), (task, config));
        }
    }

    #[test]
    fn specification_with_another_name_requires_the_task() {
        let spec = TaskSpec { name: "my_stack".to_owned(), ..stacking(32) };
        let error = compatible(&spec).unwrap_err().to_string();
        assert!(error.contains("\"my_stack\" is unknown; use one of pick_cube, stack_cube"), "{error}");
        assert_eq!(compatible_with(Task::StackCube, &spec).unwrap().image, 32);
    }

    #[test]
    fn differing_field_is_named_with_the_fix() {
        let error = |change: fn(&mut TaskSpec)| {
            let mut spec = stacking(32);
            change(&mut spec);
            compatible(&spec).unwrap_err().to_string()
        };
        let message = error(|spec| spec.cameras.truncate(1));
        assert!(
            message.starts_with("task.cameras: [table 32x32 with depth] cannot be simulated as stack_cube"),
            "{message}"
        );
        assert!(message.ends_with("it needs [table 32x32 with depth, hand 32x32 with depth]"), "{message}");
        assert!(error(|spec| spec.cameras[1].width = 64).contains("hand 32x64"));
        assert!(error(|spec| spec.cameras.clear()).starts_with("task.cameras: []"));
        assert!(error(|spec| spec.proprioception.swap(0, 1)).starts_with("task.proprioception"));
        assert!(error(|spec| spec.action[0].size = 6).starts_with("task.action"));
        assert!(error(|spec| spec.rate_hz = 20.0).starts_with("task.rate_hz: 20 cannot"));
        let message = error(|spec| spec.cameras.iter_mut().for_each(|c| (c.height, c.width) = (1024, 1024)));
        assert_eq!(message, "config.image: 1024 is out of range; choose 8 to 512");
    }

    #[test]
    fn specification_of_another_task_is_incompatible() {
        let error = compatible_with(Task::PickCube, &stacking(32)).unwrap_err().to_string();
        assert!(error.contains("proprioception") && error.contains("goal_from_tool 3"), "{error}");
    }
}
