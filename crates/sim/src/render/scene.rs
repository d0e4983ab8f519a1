//! The scene: the world as coloured boxes.
//!
//! This module does not depend on cameras or pixels.

use glam::{Vec2, Vec3};

use crate::world::{CUBE_HALF, FINGER_HALF_DEPTH, FINGER_HALF_HEIGHT, FINGER_THICKNESS, PALM_HALF, TIP_BELOW, World};

/// The cubes' colors in the world's order; red is the one to be moved.
const CUBE_COLORS: [Vec3; 2] = [Vec3::new(0.86, 0.13, 0.10), Vec3::new(0.10, 0.62, 0.16)];
const FINGER_COLOR: Vec3 = Vec3::new(0.16, 0.22, 0.42);
const PALM_COLOR: Vec3 = Vec3::new(0.82, 0.83, 0.86);
const WRIST_COLOR: Vec3 = Vec3::new(0.55, 0.57, 0.62);
const WRIST_HALF: Vec3 = Vec3::new(0.018, 0.018, 0.05);

/// A box that stands upright, turned about the vertical.
#[derive(Clone, Debug)]
pub(super) struct Block {
    pub(super) centre: Vec3,
    pub(super) half: Vec3,
    /// Unit vector along the box's x axis.
    pub(super) axis: Vec2,
    pub(super) color: Vec3,
}

impl Block {
    fn new(centre: Vec3, half: Vec3, yaw: f32, color: Vec3) -> Self {
        let axis = Vec2::from_angle(yaw);
        Self { centre, half, axis, color }
    }

    /// A direction of the world in the box's own axes.
    pub(super) fn inward(&self, direction: Vec3) -> Vec3 {
        let (c, s) = (self.axis.x, self.axis.y);
        Vec3::new(direction.x * c + direction.y * s, direction.y * c - direction.x * s, direction.z)
    }

    /// The eight corners in the world.
    pub(super) fn corners(&self) -> [Vec3; 8] {
        std::array::from_fn(|i| {
            let sign = |bit: usize| if i & bit == 0 { -1.0 } else { 1.0 };
            let local = self.half * Vec3::new(sign(1), sign(2), sign(4));
            self.centre + self.axis.rotate(local.truncate()).extend(local.z)
        })
    }
}

/// The boxes of a world: cubes, two fingers, palm, wrist.
pub(super) fn blocks(world: &World) -> Vec<Block> {
    let tool = &world.tool;
    let part = |offset: Vec3, half: Vec3, color: Vec3| {
        let turned = Vec2::from_angle(tool.yaw).rotate(offset.truncate());
        Block::new(tool.position + turned.extend(offset.z), half, tool.yaw, color)
    };
    let finger_half = Vec3::new(FINGER_THICKNESS / 2.0, FINGER_HALF_DEPTH, FINGER_HALF_HEIGHT);
    let aside = (tool.width + FINGER_THICKNESS) / 2.0;
    let finger_z = FINGER_HALF_HEIGHT - TIP_BELOW;
    let palm_z = finger_z + FINGER_HALF_HEIGHT + PALM_HALF.z;
    let wrist_z = palm_z + PALM_HALF.z + WRIST_HALF.z;
    let cubes = world.cubes.iter().zip(CUBE_COLORS.into_iter().cycle());
    let cubes = cubes.map(|(cube, color)| Block::new(cube.position, Vec3::splat(CUBE_HALF), cube.yaw, color));
    let hand = [
        part(Vec3::new(aside, 0.0, finger_z), finger_half, FINGER_COLOR),
        part(Vec3::new(-aside, 0.0, finger_z), finger_half, FINGER_COLOR),
        part(Vec3::new(0.0, 0.0, palm_z), PALM_HALF, PALM_COLOR),
        part(Vec3::new(0.0, 0.0, wrist_z), WRIST_HALF, WRIST_COLOR),
    ];
    cubes.chain(hand).collect()
}
