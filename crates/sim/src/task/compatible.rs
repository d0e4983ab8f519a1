//! Whether a task that recordings were made for can be simulated. Must not know worlds or agents.

use gleaner_recording::{CameraSpec, FieldSpec, TaskSpec};

use super::{Task, task_spec};
use crate::config::SimConfig;
use crate::error::SimError;

/// Finds the simulated task of a specification's name, and the settings whose observations and actions are the
/// specification's. The step limit is the default one.
///
/// # Errors
/// [`SimError::UnknownTask`] when no simulated task has this name, [`SimError::Incompatible`] as in
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

/// The settings with which a simulated task gives the observations and takes the actions of a specification,
/// whatever its name. The step limit is the default one.
///
/// # Errors
/// [`SimError::Incompatible`] names the first field of the specification that is not the simulated task's, and the
/// mend; [`SimError::Config`] when the simulator has no pictures of that size.
pub fn compatible_with(task: Task, spec: &TaskSpec) -> Result<SimConfig, SimError> {
    let config = match spec.cameras.first() {
        Some(camera) => SimConfig { image: camera.height, ..SimConfig::default() },
        None => SimConfig::default(),
    };
    config.validate()?;
    let simulated = task_spec(task, &config);
    let differ = |field: &'static str, given: String, wanted: String| -> Result<(), SimError> {
        if given == wanted { Ok(()) } else { Err(SimError::Incompatible { task, field, given, wanted }) }
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
    fn the_simulators_own_specification_is_found_with_its_picture_size() {
        for task in Task::ALL {
            let config = SimConfig { image: 48, ..SimConfig::default() };
            assert_eq!(compatible(&task_spec(task, &config)).unwrap(), (task, config));
        }
    }

    #[test]
    fn another_name_needs_the_task_said() {
        let spec = TaskSpec { name: "my_stack".to_owned(), ..stacking(32) };
        let error = compatible(&spec).unwrap_err().to_string();
        assert!(error.contains("\"my_stack\" is not known; use one of pick_cube, stack_cube"), "{error}");
        assert_eq!(compatible_with(Task::StackCube, &spec).unwrap().image, 32);
    }

    #[test]
    fn what_differs_is_named_with_the_mend() {
        let error = |change: fn(&mut TaskSpec)| {
            let mut spec = stacking(32);
            change(&mut spec);
            compatible(&spec).unwrap_err().to_string()
        };
        let told = error(|spec| spec.cameras.truncate(1));
        assert!(told.starts_with("task.cameras: [table 32x32 with depth] cannot be simulated as stack_cube"), "{told}");
        assert!(told.ends_with("it needs [table 32x32 with depth, hand 32x32 with depth]"), "{told}");
        assert!(error(|spec| spec.cameras[1].width = 64).contains("hand 32x64"));
        assert!(error(|spec| spec.cameras.clear()).starts_with("task.cameras: []"));
        assert!(error(|spec| spec.proprioception.swap(0, 1)).starts_with("task.proprioception"));
        assert!(error(|spec| spec.action[0].size = 6).starts_with("task.action"));
        assert!(error(|spec| spec.rate_hz = 20.0).starts_with("task.rate_hz: 20 cannot"));
        let told = error(|spec| spec.cameras.iter_mut().for_each(|c| (c.height, c.width) = (1024, 1024)));
        assert_eq!(told, "config.image: 1024 is out of range; choose 8 to 512");
    }

    #[test]
    fn one_tasks_specification_is_not_the_others() {
        let error = compatible_with(Task::PickCube, &stacking(32)).unwrap_err().to_string();
        assert!(error.contains("proprioception") && error.contains("goal_from_tool 3"), "{error}");
    }
}
