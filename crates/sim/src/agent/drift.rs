//! Motion towards random points above the table: the fault of an agent that wanders, and every false start.
//!
//! It depends neither on a task nor on a script.

use glam::Vec3;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::task::ACTION_SIZE;
use crate::world::{STEP_REACH, World};

/// Steps of motion towards one point.
pub(super) const LEG: u32 = 7;
/// The fewest steps of a false start, and the first number above its most.
const STEPS: std::ops::Range<u32> = 8..21;

/// A random point within reach of the hand.
pub(super) fn point(random: &mut ChaCha8Rng) -> Vec3 {
    let x = random.random_range(-0.18..0.18);
    let y = random.random_range(-0.18..0.18);
    Vec3::new(x, y, random.random_range(0.05..0.22))
}

/// Makes an action move the hand towards a point, without a rotation; its gripper command stays.
pub(super) fn towards(point: Vec3, world: &World, action: &mut [f32; ACTION_SIZE]) {
    let delta = ((point - world.tool.position) / STEP_REACH * 0.6).clamp_length_max(0.9);
    action[..3].copy_from_slice(&delta.to_array());
    action[5] = 0.0;
}

/// The beginning of an attempt in which an agent moves towards random points, before it follows its script.
#[derive(Clone, Debug)]
pub(crate) struct FalseStart {
    steps: u32,
    point: Vec3,
    random: ChaCha8Rng,
}

impl FalseStart {
    /// A false start whose length and points are drawn from `random`.
    pub(crate) fn new(mut random: ChaCha8Rng) -> Self {
        Self { steps: random.random_range(STEPS), point: Vec3::ZERO, random }
    }

    /// Its number of steps: the first step of the script.
    pub(crate) fn steps(&self) -> u32 {
        self.steps
    }

    /// Replaces the motion of the script's action at the given step, if that is one of the false start. The gripper follows
    /// the script.
    pub(crate) fn divert(&mut self, step: u32, world: &World, action: &mut [f32; ACTION_SIZE]) {
        if step >= self.steps {
            return;
        }
        if step.is_multiple_of(LEG) {
            self.point = point(&mut self.random);
        }
        towards(self.point, world, action);
    }
}
