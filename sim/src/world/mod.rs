//! The world and its motion: a gripper, a cube, a table, gravity.
//!
//! The table is the plane z = 0, lengths are metres, angles radians. Must not know tasks' rules, pictures or agents.

mod contact;

use glam::{Vec2, Vec3};

/// Control steps per second.
pub(crate) const RATE_HZ: f32 = 10.0;
/// Half the cube's edge.
pub(crate) const CUBE_HALF: f32 = 0.0225;
/// Widest opening between the finger pads.
pub(crate) const WIDTH_MAX: f32 = 0.08;
/// Tool travel per step and axis at action 1.
pub(crate) const STEP_REACH: f32 = 0.02;
/// Tool yaw per step at action 1.
pub(crate) const STEP_TURN: f32 = 0.15;
/// How far the finger tips lie below the tool point, which is between the pads.
pub(crate) const TIP_BELOW: f32 = 0.012;
/// Finger thickness along the closing axis and half its depth across.
pub(crate) const FINGER_THICKNESS: f32 = 0.012;
/// Half the finger's depth across the closing axis.
pub(crate) const FINGER_HALF_DEPTH: f32 = 0.010;

const SUBSTEPS: u8 = 8;
const SUBSTEP_S: f32 = 1.0 / (RATE_HZ * SUBSTEPS as f32);
/// Share of the way to the commanded velocity per substep: a time constant of about 50 ms.
const VELOCITY_GAIN: f32 = 0.25;
/// Speed of the gripper's width, in m/s.
const WIDTH_SPEED: f32 = 0.16;
const GRAVITY: f32 = 9.81;
/// Opening beyond the grasped width at which the cube falls.
const LET_GO: f32 = 0.002;
/// Where the tool may go.
const TOOL_MIN: Vec3 = Vec3::new(-0.20, -0.20, 0.015);
const TOOL_MAX: Vec3 = Vec3::new(0.20, 0.20, 0.26);

/// The gripper; its point lies midway between the finger pads, its fingers close along its x axis.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Tool {
    /// The tool point.
    pub(crate) position: Vec3,
    /// Turn about the vertical; 0 closes along the world's x axis.
    pub(crate) yaw: f32,
    /// Gap between the pads.
    pub(crate) width: f32,
    /// Velocity of the tool point in m/s.
    pub(crate) velocity: Vec3,
    turn_rate: f32,
}

impl Tool {
    /// A gripper at rest, open.
    #[must_use]
    pub(crate) fn open(position: Vec3, yaw: f32) -> Self {
        Self { position, yaw, width: WIDTH_MAX, velocity: Vec3::ZERO, turn_rate: 0.0 }
    }
}

/// The cube.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Cube {
    /// Its centre.
    pub(crate) position: Vec3,
    /// Turn about the vertical.
    pub(crate) yaw: f32,
    velocity: Vec3,
}

impl Cube {
    /// A cube at rest.
    #[must_use]
    pub(crate) fn resting(position: Vec3, yaw: f32) -> Self {
        Self { position, yaw, velocity: Vec3::ZERO }
    }
}

/// How the held cube sits in the gripper, in the tool's frame.
#[derive(Clone, Debug, PartialEq)]
struct Grip {
    offset: Vec3,
    yaw: f32,
}

/// Everything there is.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct World {
    /// The gripper.
    pub(crate) tool: Tool,
    /// The cube.
    pub(crate) cube: Cube,
    /// Where the cube's centre should go.
    pub(crate) goal: Vec3,
    grip: Option<Grip>,
}

impl World {
    /// A world at rest.
    #[must_use]
    pub(crate) fn new(tool: Tool, cube: Cube, goal: Vec3) -> Self {
        Self { tool, cube, goal, grip: None }
    }

    /// Whether the gripper holds the cube.
    #[must_use]
    pub(crate) fn holds_cube(&self) -> bool {
        self.grip.is_some()
    }

    /// Moves everything on by one control step under an action, as in [`Sim::step`](crate::Sim::step).
    pub(crate) fn step(&mut self, action: &[f32; 7]) {
        // A policy may emit anything; what is not a number commands nothing.
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
        let before = self.tool.position;
        self.move_tool();
        self.move_fingers(width_command);
        if self.grip.is_some() {
            self.carry_cube(before);
        } else {
            contact::land_fingers(&mut self.tool, &self.cube, before.z);
            let touch = contact::push_cube(&mut self.tool, &mut self.cube);
            if touch == contact::Touch::Grasped {
                self.grasp();
            } else {
                self.drop_cube();
            }
        }
        // What stopped the tool also stopped its motion, so the velocity that is read is the true one.
        self.tool.velocity = (self.tool.position - before) / SUBSTEP_S;
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

    fn grasp(&mut self) {
        let across = to_tool_frame(&self.tool, self.cube.position);
        let yaw = self.cube.yaw - self.tool.yaw;
        self.grip = Some(Grip { offset: across, yaw });
        self.cube.velocity = Vec3::ZERO;
    }

    fn carry_cube(&mut self, tool_before: Vec3) {
        let Some(grip) = &self.grip else { return };
        let turned = Vec2::from_angle(self.tool.yaw).rotate(grip.offset.truncate());
        self.cube.position = self.tool.position + turned.extend(grip.offset.z);
        self.cube.yaw = self.tool.yaw + grip.yaw;
        // Kept so that a released cube flies on with the hand's motion.
        self.cube.velocity = (self.tool.position - tool_before) / SUBSTEP_S;
    }

    fn drop_cube(&mut self) {
        let cube = &mut self.cube;
        let falling = cube.position.z > CUBE_HALF;
        if falling {
            cube.velocity.z -= GRAVITY * SUBSTEP_S;
        } else {
            // Friction takes a sliding cube's speed within a few substeps.
            cube.velocity *= Vec3::new(0.5, 0.5, 0.0);
        }
        cube.position += cube.velocity * SUBSTEP_S;
        if cube.position.z <= CUBE_HALF {
            cube.position.z = CUBE_HALF;
            cube.velocity.z = 0.0;
        }
    }
}

/// A point of the world in the tool's frame: x along the closing axis, z up.
fn to_tool_frame(tool: &Tool, point: Vec3) -> Vec3 {
    let away = point - tool.position;
    let turned = Vec2::from_angle(-tool.yaw).rotate(away.truncate());
    turned.extend(away.z)
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
