//! Grasp the cube and carry it to a goal that is given, on the table or in the air.

use glam::Vec3;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::Rules;
use crate::world::{CUBE_HALF, Cube, Tool, World};

/// The largest distance of the cube's centre from the goal that counts as success, in metres.
pub const GOAL_RADIUS: f32 = 0.03;

pub(super) const RULES: Rules = Rules {
    goal_given: true,
    begin,
    place: |world, off| world.goal.unwrap_or_default() + off.extend(0.0),
    sets_down: false,
    achieved: |world| world.goal.is_some_and(|goal| world.cube().position.distance(goal) < GOAL_RADIUS),
};

/// Cube and goal at least 8 cm apart on the table, 3 goals of 10 on the table itself, the tool above the middle.
fn begin(random: &mut ChaCha8Rng) -> World {
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
    World::new(Tool::open(tool, yaw), Cube::resting(cube, cube_yaw), &[], Some(goal))
}
