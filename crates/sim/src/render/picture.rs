//! The picture of a camera: rays are cast at the table, the boxes and the goal marker.
//!
//! A ray is `forward + right·u + down·v`; as `forward` has unit length its parameter is the depth itself.
//! Each box is tested only inside the pixels that its corners span. This module does not depend on the world.

use glam::Vec3;

use super::camera::{Camera, Rect};
use super::scene::Block;

/// Towards the light, unit length.
const LIGHT: Vec3 = Vec3::new(-0.36, -0.30, 0.883_4);
const AMBIENT: f32 = 0.50;
const SHADOW: f32 = 0.62;
const TABLE_HALF: f32 = 0.32;
const TABLE_COLOR: Vec3 = Vec3::new(0.80, 0.74, 0.64);
const TABLE_DARKER: f32 = 0.93;
const TILE: f32 = 0.05;
const FLOOR_COLOR: Vec3 = Vec3::new(0.20, 0.22, 0.25);
const GOAL_COLOR: Vec3 = Vec3::new(0.10, 0.80, 0.25);
const MARKER_RADIUS: f32 = 0.018;
const MARKER_OPACITY: f32 = 0.75;
/// The disc under the goal has the goal's own radius.
const DISC_RADIUS: f32 = crate::task::GOAL_RADIUS;
const DISC_OPACITY: f32 = 0.45;
/// Depth of a pixel whose ray meets nothing.
const NOTHING: f32 = f32::MAX;

/// Colors and depths of one picture, row by row.
pub(super) struct Picture<'a> {
    camera: &'a Camera,
    size: u32,
    color: Vec<Vec3>,
    depth: Vec<f32>,
}

/// The rectangle on the table outside which a box casts no shadow.
struct Shadow<'a> {
    block: &'a Block,
    light: Vec3,
    low: Vec3,
    high: Vec3,
}

impl<'a> Picture<'a> {
    /// Draws everything.
    pub(super) fn draw(camera: &'a Camera, size: u32, blocks: &[Block], goal: Option<Vec3>) -> Self {
        let pixels = (size * size) as usize;
        let mut picture = Self { camera, size, color: vec![FLOOR_COLOR; pixels], depth: vec![NOTHING; pixels] };
        picture.table(blocks, goal);
        for block in blocks {
            picture.block(block);
        }
        if let Some(goal) = goal {
            picture.marker(goal);
        }
        picture
    }

    /// Appends H·W·3 RGB bytes, then H·W depths as little-endian u16 millimetres; 0 where the ray meets nothing.
    pub(super) fn write(&self, out: &mut Vec<u8>) {
        for color in &self.color {
            out.extend(color.to_array().map(color_byte));
        }
        for &depth in &self.depth {
            out.extend(millimetres(depth).to_le_bytes());
        }
    }

    fn table(&mut self, blocks: &[Block], goal: Option<Vec3>) {
        let shadows: Vec<Shadow> = blocks.iter().map(Shadow::new).collect();
        let camera = self.camera;
        let mut pixel = 0;
        for row in 0..self.size {
            let line = camera.forward + camera.down * camera.offset(row);
            for column in 0..self.size {
                let ray = line + camera.right * camera.offset(column);
                let depth = -camera.eye.z / ray.z;
                let point = camera.eye + ray * depth;
                if depth > 0.0 && point.x.abs() < TABLE_HALF && point.y.abs() < TABLE_HALF {
                    self.depth[pixel] = depth;
                    self.color[pixel] = table_color(point, goal, &shadows);
                }
                pixel += 1;
            }
        }
    }

    fn block(&mut self, block: &Block) {
        let camera = self.camera;
        let Some(rect) = camera.bounds(&block.corners()) else { return };
        let eye = block.inward(camera.eye - block.centre);
        let forward = block.inward(camera.forward);
        let (right, down) = (block.inward(camera.right), block.inward(camera.down));
        let light = block.inward(LIGHT);
        for row in rect.top..rect.bottom {
            let line = forward + down * camera.offset(row);
            for column in rect.left..rect.right {
                let ray = line + right * camera.offset(column);
                let pixel = (row * self.size + column) as usize;
                if let Some((depth, normal)) = enter(eye, ray, block.half)
                    && depth < self.depth[pixel]
                {
                    self.depth[pixel] = depth;
                    let lit = AMBIENT + (1.0 - AMBIENT) * normal.dot(light).max(0.0);
                    self.color[pixel] = block.color * lit;
                }
            }
        }
    }

    /// A translucent ball at the goal, without depth; it hides nothing.
    fn marker(&mut self, goal: Vec3) {
        let camera = self.camera;
        let Some(rect) = marker_bounds(camera, goal) else { return };
        let away = camera.eye - goal;
        let c = away.length_squared() - MARKER_RADIUS * MARKER_RADIUS;
        for row in rect.top..rect.bottom {
            let line = camera.forward + camera.down * camera.offset(row);
            for column in rect.left..rect.right {
                let ray = line + camera.right * camera.offset(column);
                let (a, b) = (ray.length_squared(), away.dot(ray));
                let discriminant = b * b - a * c;
                let pixel = (row * self.size + column) as usize;
                if discriminant <= 0.0 {
                    continue;
                }
                let depth = (-b - discriminant.sqrt()) / a;
                if depth > 0.0 && depth < self.depth[pixel] {
                    let normal = (away + ray * depth) / MARKER_RADIUS;
                    let lit = GOAL_COLOR * (AMBIENT + (1.0 - AMBIENT) * normal.dot(LIGHT).max(0.0));
                    self.color[pixel] = self.color[pixel].lerp(lit, MARKER_OPACITY);
                }
            }
        }
    }
}

impl<'a> Shadow<'a> {
    fn new(block: &'a Block) -> Self {
        let corners = block.corners().map(|corner| corner - LIGHT * (corner.z / LIGHT.z));
        let low = corners.iter().fold(Vec3::MAX, |low, corner| low.min(*corner));
        let high = corners.iter().fold(Vec3::MIN, |high, corner| high.max(*corner));
        Self { block, light: block.inward(LIGHT), low, high }
    }

    fn covers(&self, point: Vec3) -> bool {
        let (low, high) = (self.low, self.high);
        if point.x < low.x || point.x > high.x || point.y < low.y || point.y > high.y {
            return false;
        }
        let from = self.block.inward(point - self.block.centre);
        enter(from, self.light, self.block.half).is_some()
    }
}

fn table_color(point: Vec3, goal: Option<Vec3>, shadows: &[Shadow]) -> Vec3 {
    let odd = ((point.x / TILE).floor() + (point.y / TILE).floor()) / 2.0;
    let mut color = if odd == odd.floor() { TABLE_COLOR } else { TABLE_COLOR * TABLE_DARKER };
    let marked = |goal: Vec3| (point - goal).truncate().length_squared() < DISC_RADIUS * DISC_RADIUS;
    if goal.is_some_and(marked) {
        color = color.lerp(GOAL_COLOR, DISC_OPACITY);
    }
    let shaded = shadows.iter().any(|shadow| shadow.covers(point));
    if shaded { color * SHADOW } else { color }
}

fn marker_bounds(camera: &Camera, goal: Vec3) -> Option<Rect> {
    // The ball lies inside this cube, so its picture lies inside the cube's.
    let corners: [Vec3; 8] = std::array::from_fn(|i| {
        let sign = |bit: usize| if i & bit == 0 { -1.0 } else { 1.0 };
        goal + Vec3::new(sign(1), sign(2), sign(4)) * MARKER_RADIUS
    });
    camera.bounds(&corners)
}

/// The point at which a ray enters a box around the origin, and the normal of the face. `None` if it misses or starts inside.
fn enter(from: Vec3, ray: Vec3, half: Vec3) -> Option<(f32, Vec3)> {
    // A ray along a face would divide by zero and compare with what is not a number.
    let inverse = ray.abs().max(Vec3::splat(1e-9)).copysign(ray).recip();
    let middle = -from * inverse;
    let reach = half * inverse.abs();
    let (near, far) = (middle - reach, middle + reach);
    let enters = near.max_element();
    if enters <= 0.0 || enters > far.min_element() {
        return None;
    }
    let normal = if enters == near.x {
        Vec3::new(-ray.x.signum(), 0.0, 0.0)
    } else if enters == near.y {
        Vec3::new(0.0, -ray.y.signum(), 0.0)
    } else {
        Vec3::new(0.0, 0.0, -ray.z.signum())
    };
    Some((enters, normal))
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "the cast saturates, which is what a camera does"
)]
fn color_byte(value: f32) -> u8 {
    (value * 255.0 + 0.5) as u8
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "bounded before the cast")]
fn millimetres(depth: f32) -> u16 {
    let value = depth * 1000.0 + 0.5;
    if value < f32::from(u16::MAX) { value as u16 } else { 0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ray_enters_a_box_through_its_nearest_face() {
        let half = Vec3::new(1.0, 2.0, 3.0);
        let (depth, normal) = enter(Vec3::new(-5.0, 0.5, 0.5), Vec3::X, half).unwrap();
        assert_eq!((depth, normal), (4.0, Vec3::NEG_X));
        assert!(enter(Vec3::new(-5.0, 2.5, 0.5), Vec3::X, half).is_none(), "passes by");
        assert!(enter(Vec3::new(5.0, 0.5, 0.5), Vec3::X, half).is_none(), "lies behind");
        assert!(enter(Vec3::ZERO, Vec3::X, half).is_none(), "starts inside");
    }

    #[test]
    fn depth_is_in_millimetres_and_zero_without_an_object() {
        assert_eq!(millimetres(0.1234), 123);
        assert_eq!(millimetres(NOTHING), 0);
        assert_eq!(color_byte(1.2), 255);
    }
}
