//! The tasks: their names, their fields, and the rules of each.
//!
//! This module does not depend on images, agents or files.

mod compatible;
mod pick_cube;
mod referee;
mod stack_cube;

use std::fmt;
use std::str::FromStr;

use glam::{Vec2, Vec3};
use gleaner_recording::{Alignment, Bound, CameraSpec, FieldSpec, TaskSpec, written_mapping};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use crate::config::SimConfig;
use crate::error::SimError;
use crate::world::{RATE_HZ, World};

pub use compatible::{compatible, compatible_with, simulated};
pub use pick_cube::GOAL_RADIUS;
pub(crate) use referee::Referee;

/// Number of action values: delta position 3, delta rotation 3, gripper 1.
pub const ACTION_SIZE: usize = 7;

/// A name and a size for each of some fields, in order.
type Fields = &'static [(&'static str, u32)];

/// Proprioception of every task. It has no cube, so a policy must use the images.
const HAND: Fields = &[("tool_position", 3), ("tool_yaw", 2), ("gripper_width", 1), ("tool_velocity", 3)];
/// Proprioception of a task whose goal is given.
const GOAL: Fields = &[("goal", 3), ("goal_from_tool", 3)];
/// The action of every task; each value is within ±1.
const ACTION: Fields = &[("delta_position", 3), ("delta_rotation", 3), (GRIPPER, 1)];
/// The field that is −1 (close) or 1 (open).
const GRIPPER: &str = "gripper";

/// The differences between tasks.
pub(crate) struct Rules {
    /// Whether the proprioception has the goal. It is true exactly if [`World::goal`] is set.
    pub(crate) goal_given: bool,
    /// A random initial world.
    pub(crate) begin: fn(&mut ChaCha8Rng) -> World,
    /// The place of the held cube's centre, with an offset along the table for a wrong place.
    pub(crate) place: fn(&World, Vec2) -> Vec3,
    /// Whether the cube is set down from above and released; otherwise it is held at its place.
    pub(crate) sets_down: bool,
    /// Whether the goal is reached, if the state lasts.
    pub(crate) achieved: fn(&World) -> bool,
}

/// A robot skill that can be simulated.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Task {
    /// Grasp the cube and carry it to the goal, which lies on the table or in the air.
    PickCube,
    /// Grasp the red cube, put it on the green one and release it.
    StackCube,
}

impl Task {
    /// Every task.
    pub const ALL: [Self; 2] = [Self::PickCube, Self::StackCube];

    /// The task's name, as in its [`TaskSpec`].
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::PickCube => "pick_cube",
            Self::StackCube => "stack_cube",
        }
    }

    /// The task's description.
    pub(crate) fn rules(self) -> &'static Rules {
        match self {
            Self::PickCube => &pick_cube::RULES,
            Self::StackCube => &stack_cube::RULES,
        }
    }
}

impl fmt::Display for Task {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Task {
    type Err = SimError;

    fn from_str(text: &str) -> Result<Self, SimError> {
        let named = Self::ALL.into_iter().find(|task| task.name() == text);
        named.ok_or_else(|| SimError::UnknownTask { given: text.to_owned(), known: Self::ALL.map(Self::name).to_vec() })
    }
}

/// The task specification of the simulator's recordings and sessions.
///
/// Cameras `table` (fixed, oblique) and `hand` (on the wrist, looking down), both RGB and depth. Proprioception:
/// tool position (m), sine and cosine of the tool's yaw, gripper width (m), tool velocity (m/s), 9 values; of
/// [`Task::PickCube`] also goal (m) and goal − tool (m), 15 values. In [`Task::StackCube`] a policy must see where
/// the green cube is. Action, 7 values as in [`Sim::step`](crate::Sim::step).
#[must_use]
pub fn task_spec(task: Task, config: &SimConfig) -> TaskSpec {
    let size = config.image_size();
    let camera =
        |name: &str| CameraSpec { name: name.to_owned(), height: size, width: size, depth: true, recorded: None };
    let goal = if task.rules().goal_given { GOAL } else { &[] };
    let mut spec = TaskSpec {
        name: task.name().to_owned(),
        instruction: String::new(),
        openpi: Vec::new(),
        rate_hz: f64::from(RATE_HZ),
        cameras: vec![camera("table"), camera("hand")],
        proprioception: fields(HAND).chain(fields(goal)).collect(),
        action: fields(ACTION).map(within_one).collect(),
        alignment: Alignment::default(),
        tolerance: 0.25,
        mappings: Vec::new(),
    };
    let mapping = written_mapping(&spec);
    spec.mappings.push(mapping);
    spec
}

fn fields(list: Fields) -> impl Iterator<Item = FieldSpec> {
    list.iter().map(|&(name, size)| FieldSpec::new(name, size))
}

fn within_one(field: FieldSpec) -> FieldSpec {
    FieldSpec {
        minimum: Some(Bound::All(-1.0)),
        maximum: Some(Bound::All(1.0)),
        binary: field.name == GRIPPER,
        ..field
    }
}

/// The proprioception vector of the world's present state.
pub(crate) fn proprioception(world: &World) -> Vec<f32> {
    let tool = &world.tool;
    let mut values = Vec::with_capacity(15);
    values.extend(tool.position.to_array());
    values.extend([tool.yaw.sin(), tool.yaw.cos()]);
    values.push(tool.width);
    values.extend(tool.velocity.to_array());
    if let Some(goal) = world.goal {
        values.extend(goal.to_array());
        values.extend((goal - tool.position).to_array());
    }
    values
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    #[test]
    fn unknown_name_is_rejected_with_the_known_ones() {
        for task in Task::ALL {
            assert_eq!(task.to_string().parse::<Task>().unwrap(), task);
        }
        let error = "stack".parse::<Task>().unwrap_err().to_string();
        assert_eq!(error, "task: \"stack\" is unknown; use one of pick_cube, stack_cube");
    }

    #[test]
    fn each_specification_is_valid_and_fits_the_values() {
        for (task, size) in [(Task::PickCube, 15), (Task::StackCube, 9)] {
            let spec = task_spec(task, &SimConfig::default());
            gleaner_recording::validate(&spec).unwrap();
            assert_eq!(spec.action_size(), ACTION_SIZE);
            let world = (task.rules().begin)(&mut ChaCha8Rng::seed_from_u64(1));
            assert_eq!(proprioception(&world).len(), size);
            assert_eq!(spec.proprioception_size(), size);
            assert_eq!(spec.mappings.len(), 1);
        }
    }
}
