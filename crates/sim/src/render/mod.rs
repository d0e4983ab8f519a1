//! Rendered RGBD cameras: a small ray caster on the processor.
//!
//! It depends on the world, not on the rules of tasks, agents or files.

mod camera;
mod picture;
mod scene;

use crate::world::World;
use camera::Camera;
use picture::Picture;

/// Bytes of one pixel: three of color, two of depth.
const PIXEL_BYTES: usize = 5;

/// Renders both cameras: first `table`, then `hand`, each H·W·3 RGB bytes and then H·W depths in millimetres as
/// little-endian u16, 0 where there is nothing. The goal's marker shows in color only.
pub(crate) fn frames(world: &World, size: u32) -> Vec<u8> {
    let blocks = scene::blocks(world);
    let cameras = [Camera::table(size), Camera::hand(world.tool.position, world.tool.yaw, size)];
    let mut out = Vec::with_capacity(cameras.len() * (size * size) as usize * PIXEL_BYTES);
    for camera in &cameras {
        Picture::draw(camera, size, &blocks, world.goal).write(&mut out);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::task::Task;
    use crate::world::{CUBE_HALF, Cube, TIP_BELOW, Tool};
    use glam::Vec3;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    const SIZE: u32 = 64;
    const GOAL: Vec3 = Vec3::new(-0.1, -0.06, 0.12);
    const PICTURE: usize = (SIZE * SIZE) as usize * PIXEL_BYTES;

    fn world_with_tool(tool: Vec3) -> World {
        let cube = Cube::resting(Vec3::new(0.0, 0.02, CUBE_HALF), 0.3);
        World::new(Tool::open(tool, 0.1), cube, &[], Some(GOAL))
    }

    fn color_at(picture: &[u8], column: u32, row: u32) -> [u8; 3] {
        let at = ((row * SIZE + column) * 3) as usize;
        picture[at..at + 3].try_into().unwrap()
    }

    fn depth_at(picture: &[u8], column: u32, row: u32) -> u16 {
        let at = (SIZE * SIZE * 3 + (row * SIZE + column) * 2) as usize;
        u16::from_le_bytes([picture[at], picture[at + 1]])
    }

    fn pixels(picture: &[u8], is_it: impl Fn(&[u8]) -> bool) -> usize {
        picture[..(SIZE * SIZE * 3) as usize].chunks_exact(3).filter(|color| is_it(color)).count()
    }

    fn red_pixels(picture: &[u8]) -> usize {
        pixels(picture, |c| c[0] > 90 && c[1] < 60 && c[2] < 60)
    }

    fn green_pixels(picture: &[u8]) -> usize {
        pixels(picture, |c| c[1] > 60 && c[0] < 40 && c[2] < 50)
    }

    #[test]
    fn table_camera_shows_the_cubes_at_every_start() {
        for (task, seed) in (0..100).flat_map(|seed| Task::ALL.map(|task| (task, seed))) {
            let world = (task.rules().begin)(&mut ChaCha8Rng::seed_from_u64(seed));
            let picture = &frames(&world, SIZE)[..PICTURE];
            assert!(red_pixels(picture) >= 20, "{task}, seed {seed}");
            assert!(task == Task::PickCube || green_pixels(picture) >= 20, "{task}, seed {seed}");
        }
    }

    #[test]
    fn hand_camera_shows_the_cube_at_the_grasp() {
        let world = world_with_tool(Vec3::new(0.0, 0.02, CUBE_HALF));
        let all = frames(&world, SIZE);
        assert!(red_pixels(&all[PICTURE..]) >= 100);
        assert!(red_pixels(&all[..PICTURE]) >= 20);
    }

    #[test]
    fn depth_is_the_distance_along_the_optical_axis() {
        let world = world_with_tool(Vec3::new(0.15, 0.15, 0.2));
        let all = frames(&world, SIZE);
        let camera = Camera::table(SIZE);
        let top = Vec3::new(0.0, 0.02, 2.0 * CUBE_HALF);
        let bare = Vec3::new(-0.12, 0.06, 0.0);
        for point in [top, bare] {
            let (column, row, depth) = camera.pixel(point).unwrap();
            let seen = f32::from(depth_at(&all, column, row)) / 1000.0;
            // One pixel spans about 6 mm of the oblique table.
            assert!((seen - depth).abs() < 0.006, "{point}: {seen} for {depth}");
        }
        let (column, row, _) = camera.pixel(top).unwrap();
        assert!(color_at(&all, column, row)[0] > 150, "the top is bright red");
    }

    #[test]
    fn goal_marker_has_color_and_no_depth() {
        let mut world = world_with_tool(Vec3::new(0.15, 0.15, 0.2));
        let with = frames(&world, SIZE);
        let (column, row, _) = Camera::table(SIZE).pixel(GOAL).unwrap();
        let [red, green, blue] = color_at(&with, column, row);
        assert!(green > 100 && green > red + 40 && green > blue + 40);
        world.goal = Some(Vec3::new(0.1, 0.1, 0.02));
        let without = frames(&world, SIZE);
        assert_eq!(depth_at(&with, column, row), depth_at(&without, column, row));
    }

    #[test]
    fn fingers_cast_a_shadow_and_hide_what_is_behind() {
        let low = world_with_tool(Vec3::new(0.0, -0.06, TIP_BELOW + 0.005));
        let high = world_with_tool(Vec3::new(0.15, 0.15, 0.2));
        let (low, high) = (frames(&low, SIZE), frames(&high, SIZE));
        assert!(red_pixels(&low[..PICTURE]) < red_pixels(&high[..PICTURE]));
    }
}
