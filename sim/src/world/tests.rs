//! Tests of motion, grasping, falling and pushing.

use super::*;

const STAY_OPEN: [f32; 7] = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0];
const CLOSE: [f32; 7] = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0];

/// A gripper around a cube at the origin, off by the given offset and turned by the given yaw.
fn around_cube(offset: Vec3, yaw: f32) -> World {
    let cube = Vec3::new(0.0, 0.0, CUBE_HALF);
    let tool = Tool::open(cube + offset, yaw);
    World::new(tool, Cube::resting(cube, 0.0), Vec3::new(0.1, 0.1, 0.1))
}

fn run(world: &mut World, action: [f32; 7], steps: u32) {
    for _ in 0..steps {
        world.step(&action);
    }
}

#[test]
fn closing_around_the_cube_grasps_it_and_stops_at_its_size() {
    let mut world = around_cube(Vec3::new(0.005, 0.004, 0.0), 0.2);
    run(&mut world, CLOSE, 6);
    assert!(world.holds_cube());
    assert!((world.tool.width - 2.0 * CUBE_HALF).abs() < 1e-6);
    assert!(misalignment(world.tool.yaw, world.cube.yaw).abs() < 1e-5);
}

#[test]
fn closing_beside_above_or_askew_holds_nothing() {
    let beside = Vec3::new(0.0, 0.025, 0.0);
    let above = Vec3::new(0.0, 0.0, 2.2 * CUBE_HALF);
    for (offset, yaw) in [(beside, 0.0), (above, 0.0), (Vec3::ZERO, 0.6)] {
        let mut world = around_cube(offset, yaw);
        run(&mut world, CLOSE, 8);
        assert!(!world.holds_cube(), "{offset} {yaw}");
    }
}

#[test]
fn a_held_cube_follows_and_falls_when_released() {
    let mut world = around_cube(Vec3::ZERO, 0.0);
    run(&mut world, CLOSE, 4);
    run(&mut world, [0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0], 5);
    assert!(world.cube.position.z > 0.10);
    run(&mut world, STAY_OPEN, 8);
    assert!(!world.holds_cube());
    assert!((world.cube.position.z - CUBE_HALF).abs() < 1e-6);
}

#[test]
fn a_finger_that_comes_down_on_the_cube_stops_there() {
    let mut world = around_cube(Vec3::new(0.045, 0.0, 0.10), 0.0);
    run(&mut world, [0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 1.0], 10);
    let tip = world.tool.position.z - TIP_BELOW;
    assert!((tip - 2.0 * CUBE_HALF).abs() < 1e-5, "{tip}");
    assert!(world.tool.velocity.z.abs() < 1e-3);
}

#[test]
fn closed_fingers_push_the_cube_along_the_table() {
    let mut world = around_cube(Vec3::new(-0.08, 0.0, 0.0), 0.0);
    world.tool.width = 0.0;
    run(&mut world, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0], 6);
    assert!(world.cube.position.x > 0.02, "{}", world.cube.position);
    assert!((world.cube.position.z - CUBE_HALF).abs() < 1e-6);
    assert!(!world.holds_cube());
}

#[test]
fn what_is_not_a_number_commands_nothing() {
    let mut world = around_cube(Vec3::new(0.0, 0.0, 0.1), 0.0);
    let before = world.clone();
    run(&mut world, [f32::NAN, f32::NAN, 0.0, 9.0, -9.0, f32::NAN, f32::NAN], 3);
    assert_eq!(world, before);
    run(&mut world, [f32::INFINITY, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], 1);
    assert!(world.tool.position.x > 0.0 && world.tool.position.x <= STEP_REACH);
}

#[test]
fn a_step_at_full_speed_covers_its_reach() {
    let mut world = around_cube(Vec3::new(-0.1, 0.0, 0.1), 0.0);
    run(&mut world, [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0], 2);
    let (x, yaw) = (world.tool.position.x, world.tool.yaw);
    run(&mut world, [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0], 1);
    assert!((world.tool.position.x - x - STEP_REACH).abs() < 1e-3);
    assert!((world.tool.yaw - yaw - STEP_TURN).abs() < 1e-2);
}
