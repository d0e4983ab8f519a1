//! The scripted expert: approach, close, carry, set down where the task requires it; after a miss, back off and try again.
//!
//! Its actions depend on visible state, and on memory only where necessary, so that they can be imitated. It also gives the
//! right action after any action of another agent. It depends on the rules of a task, not on a particular task.

use glam::{Vec2, Vec3};
use rand::{Rng, RngExt};
use rand_chacha::ChaCha8Rng;

use crate::task::{ACTION_SIZE, Task};
use crate::world::{STEP_REACH, STEP_TURN, WIDTH_MAX, World, misalignment};

const OPEN: f32 = 1.0;
const CLOSE: f32 = -1.0;
/// The hand descends when it is over the grasp point within this distance.
const ABOVE: f32 = 0.008;
/// Over this much horizontal distance the hand sinks from hovering to grasping, or from carrying to the goal.
const SLOPE: f32 = 0.025;
/// The fingers close within this distance of the grasp point.
const AT_GRASP: f32 = 0.010;
/// The fingers close after this many steps above the grasp point, wherever the hand is.
const GRASP_STEPS: u32 = 8;
/// A cube that is not held after this many steps of closing was missed.
const CLOSING: u32 = 5;
/// The height of the carried cube above the straight line to the goal while far from it.
const CARRY_OVER: f32 = 0.03;
/// A cube that is set down descends within this horizontal distance of its place.
const COME_DOWN: f32 = ABOVE + SLOPE;
/// Within this distance below its carrying height, such a cube rises before it moves across.
const CLIMB: f32 = 0.03;
/// A cube is released within this distance of its place.
const AT_PLACE: f32 = 0.010;
/// The cube is released after this many steps near the place, wherever it is.
const RELEASE_STEPS: u32 = 10;
/// The largest distance of a released cube from its place that counts as placed.
const PLACED: f32 = 0.0225;
/// The height above the cube's place at which the hand waits after success.
const WAIT_OVER: f32 = 0.08;
/// A wrong grasp point takes effect within this horizontal distance of the cube.
const NEAR_CUBE: f32 = 0.05;
/// Half-width of the random motion of the hand, in action units: 4 mm a step. It demonstrates recovery from small errors.
const WOBBLE: f32 = 0.20;

/// The habits of one expert, which are random.
#[derive(Clone, Debug)]
struct Habits {
    gain: f32,
    speed: f32,
    hover: f32,
}

/// The aim of an agent that follows the expert's script. The default is the expert's aim except for `recovers`.
#[derive(Clone, Debug)]
pub(crate) struct Aim {
    /// Added to the grasp point once near the cube.
    pub(crate) grasp_off: Vec2,
    /// Added to the goal.
    pub(crate) goal_off: Vec2,
    /// Whether it detects a missed grasp.
    pub(crate) recovers: bool,
}

impl Default for Aim {
    fn default() -> Self {
        Self { grasp_off: Vec2::ZERO, goal_off: Vec2::ZERO, recovers: true }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    /// Towards the cube with open fingers; the steps spent above the grasp point.
    Approach { above: u32 },
    /// Fingers closing, with the steps so far.
    Close { steps: u32 },
    /// Towards the goal; the steps spent near it.
    Carry { near: u32 },
    /// Fingers opening at the goal.
    Release,
    /// Up and open while the cube is at its place.
    Finish,
    /// Up and open after a miss, with the remaining steps.
    Retreat { left: u32 },
}

/// A scripted agent that reads the true state.
#[derive(Clone, Debug)]
pub(crate) struct Expert {
    task: Task,
    habits: Habits,
    aim: Aim,
    stage: Stage,
    near_cube: bool,
    random: ChaCha8Rng,
}

impl Expert {
    /// The expert, with habits from these random numbers.
    pub(crate) fn new(task: Task, random: ChaCha8Rng) -> Self {
        Self::aiming(task, Aim::default(), random)
    }

    /// An agent with the same script and habits, and another aim.
    pub(crate) fn aiming(task: Task, aim: Aim, mut random: ChaCha8Rng) -> Self {
        let habits = Habits {
            gain: random.random_range(0.55..0.75),
            speed: random.random_range(0.8..1.0),
            hover: random.random_range(0.048..0.062),
        };
        Self { task, habits, aim, stage: Stage::Approach { above: 0 }, near_cube: false, random }
    }

    /// Whether it carries: it has grasped and not yet released.
    pub(crate) fn carries(&self) -> bool {
        matches!(self.stage, Stage::Carry { .. })
    }

    /// The next action.
    pub(crate) fn act(&mut self, world: &World) -> [f32; ACTION_SIZE] {
        // Drawn in every step, so that two agents on the same states stay equal.
        let wobble = wobble(&mut self.random);
        self.advance(world);
        let tool = &world.tool;
        let (target, gripper) = match self.stage {
            Stage::Approach { .. } => (self.approach_point(world), OPEN),
            Stage::Close { .. } => (tool.position, CLOSE),
            Stage::Carry { .. } => (self.carry_point(world), CLOSE),
            Stage::Release => (tool.position, OPEN),
            Stage::Finish => (tool.position.with_z(self.place(world).z + WAIT_OVER), OPEN),
            Stage::Retreat { .. } => (tool.position + Vec3::Z * STEP_REACH, OPEN),
        };
        let (steady, turn) = match self.stage {
            Stage::Approach { .. } => (wobble, misalignment(tool.yaw, world.cube().yaw) / STEP_TURN * self.habits.gain),
            Stage::Carry { .. } | Stage::Finish | Stage::Retreat { .. } => (wobble, 0.0),
            Stage::Close { .. } | Stage::Release => (Vec3::ZERO, 0.0),
        };
        let reach = (target - tool.position) / STEP_REACH * self.habits.gain;
        let delta = reach.clamp_length_max(self.habits.speed) + steady;
        let [x, y, z] = delta.clamp(Vec3::NEG_ONE, Vec3::ONE).to_array();
        [x, y, z, 0.0, 0.0, turn.clamp(-1.0, 1.0), gripper]
    }

    /// Chooses the stage for the present state.
    fn advance(&mut self, world: &World) {
        let away = world.cube().position.truncate() - world.tool.position.truncate();
        self.near_cube |= away.length() < NEAR_CUBE;
        self.stage = match self.stage {
            // Another agent may have grasped it.
            Stage::Approach { .. } | Stage::Retreat { .. } | Stage::Finish if world.holds_cube() => {
                Stage::Carry { near: 0 }
            }
            Stage::Approach { above } => self.approach(above, world),
            Stage::Close { .. } if world.holds_cube() => Stage::Carry { near: 0 },
            Stage::Close { steps } if steps < CLOSING => Stage::Close { steps: steps + 1 },
            Stage::Close { .. } if self.aim.recovers => Stage::Retreat { left: 4 },
            Stage::Close { .. } => Stage::Carry { near: 0 },
            Stage::Carry { .. } if self.aim.recovers && !world.holds_cube() => Stage::Retreat { left: 4 },
            Stage::Carry { near } if self.task.rules().sets_down => self.set_down(near, world),
            Stage::Carry { near } => Stage::Carry { near },
            Stage::Release if world.holds_cube() => Stage::Release,
            Stage::Release | Stage::Finish if self.misplaced(world) => Stage::Retreat { left: 4 },
            Stage::Release | Stage::Finish => Stage::Finish,
            Stage::Retreat { left } if left > 0 || world.tool.width < 0.9 * WIDTH_MAX => {
                Stage::Retreat { left: left.saturating_sub(1) }
            }
            Stage::Retreat { .. } => Stage::Approach { above: 0 },
        };
    }

    fn approach(&self, above: u32, world: &World) -> Stage {
        let miss = self.grasp_point(world) - world.tool.position;
        let over = miss.truncate().length() < 1.5 * ABOVE;
        let turned = misalignment(world.tool.yaw, world.cube().yaw).abs() < 0.15;
        if (miss.length() < AT_GRASP && turned) || above >= GRASP_STEPS {
            Stage::Close { steps: 0 }
        } else {
            Stage::Approach { above: above + u32::from(over) }
        }
    }

    fn set_down(&self, near: u32, world: &World) -> Stage {
        let miss = self.final_point(world) - world.tool.position;
        let close = miss.truncate().length() < COME_DOWN;
        if miss.length() < AT_PLACE || near >= RELEASE_STEPS {
            Stage::Release
        } else {
            Stage::Carry { near: near + u32::from(close) }
        }
    }

    /// Whether it detects that the released cube is not at its place. An agent with a wrong place, or without recovery,
    /// does not.
    fn misplaced(&self, world: &World) -> bool {
        let looks = self.aim.recovers && self.aim.goal_off == Vec2::ZERO;
        looks && world.cube().position.distance(self.place(world)) > PLACED
    }

    fn grasp_point(&self, world: &World) -> Vec3 {
        let off = if self.near_cube { self.aim.grasp_off } else { Vec2::ZERO };
        world.cube().position + off.extend(0.0)
    }

    /// The grasp point, raised with the distance of the hand.
    fn approach_point(&self, world: &World) -> Vec3 {
        let grasp = self.grasp_point(world);
        let miss = (grasp - world.tool.position).truncate().length();
        grasp + Vec3::Z * self.habits.hover * ((miss - ABOVE) / SLOPE).clamp(0.0, 1.0)
    }

    /// The place of the cube.
    fn place(&self, world: &World) -> Vec3 {
        (self.task.rules().place)(world, self.aim.goal_off)
    }

    /// The position of the tool at which the cube is at its place.
    fn final_point(&self, world: &World) -> Vec3 {
        let in_hand = if world.holds_cube() { world.cube().position - world.tool.position } else { Vec3::ZERO };
        self.place(world) - in_hand
    }

    /// The final point, raised while far off. A cube that is set down on another first rises above it.
    fn carry_point(&self, world: &World) -> Vec3 {
        let tool = world.tool.position;
        let last = self.final_point(world);
        let away = (last - tool).truncate();
        let over = CARRY_OVER * ((away.length() - ABOVE) / SLOPE).clamp(0.0, 1.0);
        let point = last + Vec3::Z * over;
        if !self.task.rules().sets_down || away.length() < COME_DOWN {
            return point;
        }
        let low = (last.z + CARRY_OVER / 2.0 - tool.z).max(0.0);
        let across = (1.0 - low / CLIMB).clamp(0.1, 1.0);
        (tool.truncate() + away * across).extend(point.z)
    }
}

fn wobble(random: &mut impl Rng) -> Vec3 {
    Vec3::from_array(std::array::from_fn(|_| random.random_range(-WOBBLE..WOBBLE)))
}
