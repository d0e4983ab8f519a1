//! The tasks: how an attempt begins, what its steps hold and when it has succeeded.
//!
//! Must not know cameras' pictures, agents or files.

use std::fmt;
use std::str::FromStr;

use glam::Vec3;
use gleaner_recording::{Alignment, CameraSpec, FieldSpec, TaskSpec, written_mapping};
use rand::{Rng, RngExt};
use serde::{Deserialize, Serialize};

use crate::config::SimConfig;
use crate::error::SimError;
use crate::world::{CUBE_HALF, Cube, RATE_HZ, Tool, World};

/// Number of action values: delta position 3, delta rotation 3, gripper 1.
pub const ACTION_SIZE: usize = 7;
/// How near the goal the cube's centre must come, in metres.
pub const GOAL_RADIUS: f32 = 0.03;
/// A cube that moves less than this in a step counts as still, in metres.
const STILL: f32 = 0.012;
/// How many steps in a row the cube must be at the goal and still.
const SETTLED_STEPS: u32 = 2;

/// Names and sizes of the proprioception fields, in order. The cube is not among them: a policy must look.
const PROPRIOCEPTION: [(&str, u32); 6] = [
    ("tool_position", 3),
    ("tool_yaw", 2),
    ("gripper_width", 1),
    ("tool_velocity", 3),
    ("goal", 3),
    ("goal_from_tool", 3),
];
/// Names and sizes of the action fields, in order.
const ACTION: [(&str, u32); 3] = [("delta_position", 3), ("delta_rotation", 3), ("gripper", 1)];

/// A robot skill that can be simulated.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Task {
    /// Grasp the cube and carry it to the goal, which lies on the table or in the air.
    PickCube,
}

impl Task {
    /// The task's name, as in its [`TaskSpec`].
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::PickCube => "pick_cube",
        }
    }

    /// A world at the beginning of an attempt, drawn at random.
    pub(crate) fn begin(self, random: &mut impl Rng) -> World {
        match self {
            Self::PickCube => begin_pick_cube(random),
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
        match text {
            "pick_cube" => Ok(Self::PickCube),
            _ => Err(SimError::UnknownTask(text.to_owned())),
        }
    }
}

/// The task specification of the simulator's recordings and sessions.
///
/// Cameras `table` (fixed, oblique) and `hand` (on the wrist, looking down), both RGB and depth. Proprioception,
/// 15 values: tool position (m), sine and cosine of the tool's yaw, gripper width (m), tool velocity (m/s), goal
/// (m), goal − tool (m). Action, 7 values as in [`Sim::step`](crate::Sim::step).
#[must_use]
pub fn task_spec(task: Task, config: &SimConfig) -> TaskSpec {
    let size = config.image_size();
    let camera = |name: &str| CameraSpec { name: name.to_owned(), height: size, width: size, depth: true };
    let fields = |list: &[(&str, u32)]| -> Vec<FieldSpec> {
        list.iter().map(|&(name, size)| FieldSpec { name: name.to_owned(), size }).collect()
    };
    let mut spec = TaskSpec {
        name: task.name().to_owned(),
        rate_hz: f64::from(RATE_HZ),
        cameras: vec![camera("table"), camera("hand")],
        proprioception: fields(&PROPRIOCEPTION),
        action: fields(&ACTION),
        alignment: Alignment::default(),
        tolerance: 0.25,
        mappings: Vec::new(),
    };
    let mapping = written_mapping(&spec);
    spec.mappings.push(mapping);
    spec
}

/// The proprioception vector of the world's present state.
pub(crate) fn proprioception(world: &World) -> Vec<f32> {
    let tool = &world.tool;
    let mut values = Vec::with_capacity(15);
    values.extend(tool.position.to_array());
    values.extend([tool.yaw.sin(), tool.yaw.cos()]);
    values.push(tool.width);
    values.extend(tool.velocity.to_array());
    values.extend(world.goal.to_array());
    values.extend((world.goal - tool.position).to_array());
    values
}

/// Watches one attempt for success: the cube within [`GOAL_RADIUS`] of the goal, held or settled there.
#[derive(Clone, Debug)]
pub(crate) struct Referee {
    last: Vec3,
    settled: u32,
}

impl Referee {
    /// Begins to watch this world.
    pub(crate) fn new(world: &World) -> Self {
        Self { last: world.cube.position, settled: 0 }
    }

    /// Takes note of one step; true once the task has succeeded, and from then on.
    pub(crate) fn watch(&mut self, world: &World) -> bool {
        if self.settled >= SETTLED_STEPS {
            return true;
        }
        let cube = world.cube.position;
        let still = cube.distance(self.last) < STILL;
        let there = cube.distance(world.goal) < GOAL_RADIUS;
        self.settled = if still && there { self.settled + 1 } else { 0 };
        self.last = cube;
        self.settled >= SETTLED_STEPS
    }
}

/// Cube and goal at least 8 cm apart on the table, 3 goals of 10 on the table itself, the tool above the middle.
fn begin_pick_cube(random: &mut impl Rng) -> World {
    let mut spot =
        |reach: f32, z: f32| Vec3::new(random.random_range(-reach..reach), random.random_range(-reach..reach), z);
    let cube = spot(0.10, CUBE_HALF);
    let mut goal = spot(0.12, CUBE_HALF);
    while goal.distance(cube) < 0.08 {
        goal = spot(0.12, CUBE_HALF);
    }
    let mut tool = spot(0.06, 0.0);
    if !random.random_bool(0.3) {
        goal.z = random.random_range(0.07..0.17);
    }
    tool.z = random.random_range(0.13..0.19);
    let yaw = random.random_range(-0.2..0.2);
    let cube_yaw = random.random_range(-0.45..0.45);
    World::new(Tool::open(tool, yaw), Cube::resting(cube, cube_yaw), goal)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn a_name_reads_back_and_a_wrong_one_says_the_right_one() {
        assert_eq!(Task::PickCube.to_string().parse::<Task>().unwrap(), Task::PickCube);
        let error = "stack".parse::<Task>().unwrap_err().to_string();
        assert_eq!(error, "task: \"stack\" is not known; use \"pick_cube\"");
    }

    #[test]
    fn the_specification_is_sound_and_fits_the_values() {
        let spec = task_spec(Task::PickCube, &SimConfig::default());
        spec.validate().unwrap();
        assert_eq!(spec.action_size(), ACTION_SIZE);
        let world = Task::PickCube.begin(&mut ChaCha8Rng::seed_from_u64(1));
        assert_eq!(proprioception(&world).len(), spec.proprioception_size());
        assert_eq!(spec.mappings.len(), 1);
    }

    #[test]
    fn success_needs_the_cube_still_at_the_goal_for_two_steps() {
        let mut world = Task::PickCube.begin(&mut ChaCha8Rng::seed_from_u64(1));
        let mut referee = Referee::new(&world);
        world.cube.position = world.goal + Vec3::new(0.02, 0.0, 0.0);
        assert!(!referee.watch(&world), "it has only just come");
        assert!(!referee.watch(&world), "still for one step");
        assert!(referee.watch(&world), "still for two steps");
        world.cube.position = Vec3::ZERO;
        assert!(referee.watch(&world), "success stays");
    }

    #[test]
    fn a_cube_beside_the_goal_is_no_success() {
        let mut world = Task::PickCube.begin(&mut ChaCha8Rng::seed_from_u64(1));
        world.cube.position = world.goal + Vec3::new(GOAL_RADIUS + 0.001, 0.0, 0.0);
        let mut referee = Referee::new(&world);
        assert!((0..5).all(|_| !referee.watch(&world)));
    }
}
