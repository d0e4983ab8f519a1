//! The gripper: its shape, its reach and its frame.
//!
//! This module does not depend on the cubes.

use glam::{Vec2, Vec3};

/// Widest opening between the finger pads.
pub(crate) const WIDTH_MAX: f32 = 0.08;
/// The distance of the finger tips below the tool point, which is between the pads.
pub(crate) const TIP_BELOW: f32 = 0.012;
/// Finger thickness along the closing axis.
pub(crate) const FINGER_THICKNESS: f32 = 0.012;
/// Half the finger's depth across the closing axis.
pub(crate) const FINGER_HALF_DEPTH: f32 = 0.010;
/// Half the finger's height.
pub(crate) const FINGER_HALF_HEIGHT: f32 = 0.030;
/// Half the palm's edges: along the closing axis, across it, up.
pub(crate) const PALM_HALF: Vec3 = Vec3::new(0.052, 0.018, 0.014);
/// Speed of the gripper's width, in m/s.
pub(super) const WIDTH_SPEED: f32 = 0.16;
/// The range of the tool point.
pub(super) const TOOL_MIN: Vec3 = Vec3::new(-0.20, -0.20, 0.015);
pub(super) const TOOL_MAX: Vec3 = Vec3::new(0.20, 0.20, 0.26);

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
    pub(super) turn_rate: f32,
}

impl Tool {
    /// A gripper at rest, open.
    #[must_use]
    pub(crate) fn open(position: Vec3, yaw: f32) -> Self {
        Self { position, yaw, width: WIDTH_MAX, velocity: Vec3::ZERO, turn_rate: 0.0 }
    }
}

/// A point of the world in the tool's frame: x along the closing axis, z up.
pub(super) fn to_tool_frame(tool: &Tool, point: Vec3) -> Vec3 {
    let away = point - tool.position;
    let turned = Vec2::from_angle(-tool.yaw).rotate(away.truncate());
    turned.extend(away.z)
}
