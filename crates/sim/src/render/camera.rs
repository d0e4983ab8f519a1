//! Cameras: position, rays of pixels, and pixels of points.
//!
//! This module does not depend on the scene.

use glam::{Vec2, Vec3};

/// A pinhole camera with a square picture.
#[derive(Clone, Debug)]
pub(super) struct Camera {
    pub(super) eye: Vec3,
    /// The optical axis, unit length, so that a ray's parameter is the depth along the axis.
    pub(super) forward: Vec3,
    /// One half picture to the right at depth 1.
    pub(super) right: Vec3,
    /// One half picture down at depth 1.
    pub(super) down: Vec3,
    /// Tangent of half the field of view.
    tangent: f32,
    size: u32,
}

/// A rectangle of pixels, ends excluded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Rect {
    pub(super) left: u32,
    pub(super) right: u32,
    pub(super) top: u32,
    pub(super) bottom: u32,
}

impl Camera {
    /// A camera at `eye` that looks at `target`, with `up` towards the picture's top and a field of view in degrees.
    pub(super) fn new(eye: Vec3, target: Vec3, up: Vec3, view_degrees: f32, size: u32) -> Self {
        let forward = (target - eye).normalize();
        let right = forward.cross(up).normalize();
        let tangent = (view_degrees.to_radians() / 2.0).tan();
        Self { eye, forward, right: right * tangent, down: forward.cross(right) * tangent, tangent, size }
    }

    /// The fixed camera before the table.
    pub(super) fn table(size: u32) -> Self {
        let (eye, target) = (Vec3::new(0.0, -0.44, 0.37), Vec3::new(0.0, 0.0, 0.065));
        Self::new(eye, target, Vec3::Z, 42.0, size)
    }

    /// The camera on the wrist: beside the palm, looking down and a little forward to the finger tips.
    pub(super) fn hand(tool: Vec3, yaw: f32, size: u32) -> Self {
        let side = Vec2::from_angle(yaw).perp();
        let eye = tool + (side * -0.06).extend(0.075);
        let target = eye + (side * 0.31).extend(-0.95);
        Self::new(eye, target, side.extend(0.0), 75.0, size)
    }

    /// A pixel's offset from the middle, −1 to 1, at its centre.
    pub(super) fn offset(&self, pixel: u32) -> f32 {
        (pixel as f32 + 0.5) * 2.0 / self.size as f32 - 1.0
    }

    /// The pixel and the depth of a point, if it is in front of the camera and inside the picture.
    #[cfg(test)]
    pub(super) fn pixel(&self, point: Vec3) -> Option<(u32, u32, f32)> {
        let rect = self.bounds(&[point])?;
        let inside = rect.left < rect.right && rect.top < rect.bottom;
        inside.then(|| (rect.left, rect.top, (point - self.eye).dot(self.forward)))
    }

    /// The pixels that the points span. The whole picture when one lies behind the camera, `None` if all do.
    pub(super) fn bounds(&self, points: &[Vec3]) -> Option<Rect> {
        const NEAR: f32 = 1e-3;
        let (mut low, mut high) = (Vec2::splat(f32::MAX), Vec2::splat(f32::MIN));
        let mut behind = 0;
        for &point in points {
            let away = point - self.eye;
            let depth = away.dot(self.forward);
            if depth < NEAR {
                behind += 1;
                continue;
            }
            // `right` and `down` have the tangent's length, so the product holds it once too often, squared.
            let scale = 1.0 / (depth * self.tangent * self.tangent);
            let seen = Vec2::new(away.dot(self.right), away.dot(self.down)) * scale;
            low = low.min(seen);
            high = high.max(seen);
        }
        if behind == points.len() {
            return None;
        }
        if behind > 0 {
            (low, high) = (Vec2::NEG_ONE, Vec2::ONE);
        }
        Some(Rect {
            left: self.nearest(low.x, 0),
            right: self.nearest(high.x, 1),
            top: self.nearest(low.y, 0),
            bottom: self.nearest(high.y, 1),
        })
    }

    /// The pixel at an offset, plus `more`, kept inside the picture.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the picture first")]
    fn nearest(&self, offset: f32, more: u32) -> u32 {
        let size = self.size as f32;
        let pixel = ((offset + 1.0) / 2.0 * size).floor() + more as f32;
        pixel.clamp(0.0, size) as u32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn point_projects_onto_the_pixel_whose_ray_meets_it() {
        let camera = Camera::table(64);
        for (column, row) in [(0, 0), (63, 0), (20, 41), (63, 63)] {
            let ray = camera.forward + camera.right * camera.offset(column) + camera.down * camera.offset(row);
            let (x, y, depth) = camera.pixel(camera.eye + ray * 0.4).unwrap();
            assert_eq!((x, y), (column, row));
            assert!((depth - 0.4).abs() < 1e-5);
        }
    }

    #[test]
    fn points_behind_the_camera_have_no_pixel() {
        let camera = Camera::table(64);
        assert!(camera.bounds(&[camera.eye - camera.forward]).is_none());
    }
}
