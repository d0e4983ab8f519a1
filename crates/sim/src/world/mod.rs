//! The world and its motion: a gripper, cubes, a table, gravity.
//!
//! The table is the plane z = 0; lengths are in metres, angles in radians. This module does not depend on the rules of
//! tasks, images or agents.

mod contact;
mod cubes;
mod tool;

use glam::{Vec2, Vec3};

pub(crate) use cubes::{CUBE_HALF, Cube};
pub(crate) use tool::{FINGER_HALF_DEPTH, FINGER_HALF_HEIGHT, FINGER_THICKNESS, PALM_HALF, TIP_BELOW, Tool, WIDTH_MAX};
use tool::{TOOL_MAX, TOOL_MIN, WIDTH_SPEED, to_tool_frame};

/// Control steps per second.
pub(crate) const RATE_HZ: f32 = 10.0;
/// Tool travel per step and axis at action 1.
pub(crate) const STEP_REACH: f32 = 0.02;
/// Tool yaw per step at action 1.
pub(crate) const STEP_TURN: f32 = 0.15;

const SUBSTEPS: u8 = 8;
const SUBSTEP_S: f32 = 1.0 / (RATE_HZ * SUBSTEPS as f32);
/// Share of the way to the commanded velocity per substep: a time constant of about 50 ms.
const VELOCITY_GAIN: f32 = 0.25;
/// Opening beyond the grasped width at which the cube falls.
const LET_GO: f32 = 0.002;

/// The pose of the held cube in the tool's frame.
#[derive(Clone, Debug, PartialEq)]
struct Grip {
    /// The index of the cube.
    cube: usize,
    offset: Vec3,
    yaw: f32,
}

/// The state of the world.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct World {
    /// The gripper.
    pub(crate) tool: Tool,
    /// The cubes, at least one. The first is the one to be moved.
    pub(crate) cubes: Vec<Cube>,
    /// The goal, which is marked in the images.
    pub(crate) goal: Option<Vec3>,
    grip: Option<Grip>,
}

impl World {
    /// A world at rest, with the cube to be moved and the others.
    #[must_use]
    pub(crate) fn new(tool: Tool, cube: Cube, others: &[Cube], goal: Option<Vec3>) -> Self {
        let cubes = std::iter::once(cube).chain(others.iter().cloned()).collect();
        Self { tool, cubes, goal, grip: None }
    }

    /// The cube to be moved.
    #[must_use]
    pub(crate) fn cube(&self) -> &Cube {
        &self.cubes[0]
    }

    /// Whether the gripper holds the cube to be moved.
    #[must_use]
    pub(crate) fn holds_cube(&self) -> bool {
        self.held() == Some(0)
    }

    /// Whether a cube that is not held rests on another with its centre over it.
    #[must_use]
    pub(crate) fn rests_on(&self, upper: usize, lower: usize) -> bool {
        self.held().is_none_or(|held| held != upper && held != lower)
            && cubes::rests_on(&self.cubes[upper], &self.cubes[lower])
    }

    fn held(&self) -> Option<usize> {
        self.grip.as_ref().map(|grip| grip.cube)
    }

    /// Advances the world by one control step under an action, as in [`Sim::step`](crate::Sim::step).
    pub(crate) fn step(&mut self, action: &[f32; 7]) {
        // A policy may emit NaN, which commands no motion.
        let bounded = |value: f32| if value.is_nan() { 0.0 } else { value.clamp(-1.0, 1.0) };
        let velocity = Vec3::new(bounded(action[0]), bounded(action[1]), bounded(action[2])) * STEP_REACH * RATE_HZ;
        let turn_rate = bounded(action[5]) * STEP_TURN * RATE_HZ;
        let width = if action[6] < 0.0 { 0.0 } else { WIDTH_MAX };
        for _ in 0..SUBSTEPS {
            self.tool.velocity += (velocity - self.tool.velocity) * VELOCITY_GAIN;
            self.tool.turn_rate += (turn_rate - self.tool.turn_rate) * VELOCITY_GAIN;
            self.substep(width);
        }
    }

    fn substep(&mut self, width_command: f32) {
        let tool_before = self.tool.position;
        let before = self.cubes.clone();
        self.move_tool();
        self.move_fingers(width_command);
        self.land_hand(tool_before.z);
        self.carry_cube(&before, tool_before);
        self.push_cubes();
        let held = self.held();
        cubes::ride(&mut self.cubes, &before, held);
        for index in (0..self.cubes.len()).filter(|&index| Some(index) != held) {
            cubes::drop(&mut self.cubes, index);
        }
        cubes::separate(&mut self.cubes, &before, held);
        // The velocity is that of the actual motion, which an obstacle may have stopped.
        self.tool.velocity = (self.tool.position - tool_before) / SUBSTEP_S;
    }

    fn move_tool(&mut self) {
        let tool = &mut self.tool;
        let lowest = match &self.grip {
            Some(grip) => (CUBE_HALF - grip.offset.z).max(TOOL_MIN.z),
            None => TOOL_MIN.z,
        };
        let min = Vec3::new(TOOL_MIN.x, TOOL_MIN.y, lowest);
        tool.position = (tool.position + tool.velocity * SUBSTEP_S).clamp(min, TOOL_MAX);
        tool.yaw += tool.turn_rate * SUBSTEP_S;
    }

    fn move_fingers(&mut self, command: f32) {
        let tool = &mut self.tool;
        let reach = WIDTH_SPEED * SUBSTEP_S;
        tool.width += (command - tool.width).clamp(-reach, reach);
        if self.grip.is_some() {
            tool.width = tool.width.max(2.0 * CUBE_HALF);
            if tool.width > 2.0 * CUBE_HALF + LET_GO {
                self.grip = None;
            }
        }
    }

    /// The hand comes down on cubes that it does not hold.
    fn land_hand(&mut self, z_before: f32) {
        let held = self.held();
        for (_, cube) in self.cubes.iter().enumerate().filter(|(index, _)| Some(*index) != held) {
            contact::land_hand(&mut self.tool, cube, z_before);
        }
    }

    /// Fingers push cubes that they do not hold, and grasp a cube if they hold none: of a stack the lower cube, which
    /// carries the upper one.
    fn push_cubes(&mut self) {
        let mut upwards: Vec<usize> = (0..self.cubes.len()).collect();
        upwards.sort_by(|&a, &b| self.cubes[a].position.z.total_cmp(&self.cubes[b].position.z));
        for index in upwards {
            if self.held() == Some(index) {
                continue;
            }
            let touch = contact::push_cube(&mut self.tool, &mut self.cubes[index]);
            if touch == contact::Touch::Grasped && self.grip.is_none() {
                self.grasp(index);
            }
        }
    }

    fn grasp(&mut self, index: usize) {
        let cube = &mut self.cubes[index];
        let offset = to_tool_frame(&self.tool, cube.position);
        let yaw = cube.yaw - self.tool.yaw;
        cube.velocity = Vec3::ZERO;
        self.grip = Some(Grip { cube: index, offset, yaw });
    }

    /// The held cube follows the hand; the hand stops where the held cube comes down on another.
    fn carry_cube(&mut self, before: &[Cube], tool_before: Vec3) {
        let Some(grip) = &self.grip else { return };
        let turned = Vec2::from_angle(self.tool.yaw).rotate(grip.offset.truncate());
        let mut carried = self.cubes[grip.cube].clone();
        carried.position = self.tool.position + turned.extend(grip.offset.z);
        carried.yaw = self.tool.yaw + grip.yaw;
        let rise = cubes::rise_onto(&carried, grip.cube, before);
        self.tool.position.z += rise;
        carried.position.z += rise;
        // A released cube keeps the velocity of the hand.
        carried.velocity = (self.tool.position - tool_before) / SUBSTEP_S;
        self.cubes[grip.cube] = carried;
    }
}

/// The cube's turn against the gripper, in [−π/4, π/4]: a cube looks the same after a quarter turn.
#[must_use]
pub(crate) fn misalignment(tool_yaw: f32, cube_yaw: f32) -> f32 {
    let quarter = std::f32::consts::FRAC_PI_2;
    let turn = cube_yaw - tool_yaw;
    turn - quarter * (turn / quarter).round()
}

#[cfg(test)]
mod tests;
