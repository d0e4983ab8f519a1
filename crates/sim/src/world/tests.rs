//! Tests of motion, grasping, falling and pushing.

use super::*;

const STAY_OPEN: [f32; 7] = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0];
const CLOSE: [f32; 7] = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0];

/// A gripper around a cube at the origin, off by the given offset and turned by the given yaw.
fn around_cube(offset: Vec3, yaw: f32) -> World {
    let cube = Vec3::new(0.0, 0.0, CUBE_HALF);
    let tool = Tool::open(cube + offset, yaw);
    World::new(tool, Cube::resting(cube, 0.0), &[], None)
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
    assert!(misalignment(world.tool.yaw, world.cube().yaw).abs() < 1e-5);
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
    assert!(world.cube().position.z > 0.10);
    run(&mut world, STAY_OPEN, 8);
    assert!(!world.holds_cube());
    assert!((world.cube().position.z - CUBE_HALF).abs() < 1e-6);
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
    assert!(world.cube().position.x > 0.02, "{}", world.cube().position);
    assert!((world.cube().position.z - CUBE_HALF).abs() < 1e-6);
    assert!(!world.holds_cube());
}

#[test]
fn nan_commands_no_motion() {
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

/// The rotation of the green cube in [`stacked`].
const GREEN_YAW: f32 = 0.3;

/// The gripper holds a red cube over a green one at the origin, so far off its middle, and has come down as far as
/// it goes.
fn held_over(off: Vec2) -> World {
    let mut world = around_cube(off.extend(0.0), 0.0);
    world.cubes[0].position += off.extend(0.0);
    world.tool.position = world.cubes[0].position;
    run(&mut world, CLOSE, 4);
    run(&mut world, [0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0], 5);
    world.cubes.push(Cube::resting(Vec3::new(0.0, 0.0, CUBE_HALF), GREEN_YAW));
    run(&mut world, [0.0, 0.0, -1.0, 0.0, 0.0, 0.0, -1.0], 8);
    world
}

/// The same after the release and some steps.
fn stacked(off: Vec2) -> World {
    let mut world = held_over(off);
    run(&mut world, [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], 6);
    run(&mut world, [0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0], 5);
    world
}

#[test]
fn a_held_cube_comes_down_on_another_and_stops_there() {
    for off in [Vec2::ZERO, Vec2::new(0.02, -0.01), Vec2::new(0.0, 0.04)] {
        let world = held_over(off);
        assert!(world.holds_cube());
        assert!((world.cube().position.z - 3.0 * CUBE_HALF).abs() < 1e-5, "{}", world.cube().position);
        assert_eq!(world.cubes[1].position, Vec3::new(0.0, 0.0, CUBE_HALF), "what it lies on stays");
        assert!(!world.rests_on(0, 1), "it is still in the hand");
        assert!(world.tool.velocity.z.abs() < 1e-3);
    }
}

#[test]
fn a_cube_let_go_over_another_stays_on_it() {
    for off in [Vec2::ZERO, Vec2::new(0.02, 0.0), Vec2::new(-0.01, 0.015)] {
        let mut world = stacked(off);
        assert!(world.rests_on(0, 1), "{off}: {}", world.cube().position);
        let before = world.cubes.clone();
        run(&mut world, STAY_OPEN, 20);
        assert_eq!(world.cubes, before, "a stack is stable");
    }
}

#[test]
fn a_cube_let_go_over_the_edge_slides_off_and_falls_beside() {
    for off in [Vec2::new(0.03, 0.0), Vec2::new(0.0, -0.035), Vec2::new(0.03, 0.03)] {
        let world = stacked(off);
        let [red, green] = [0, 1].map(|cube| world.cubes[cube].position);
        assert!(!world.rests_on(0, 1));
        assert!((red.z - CUBE_HALF).abs() < 1e-6, "{off}: {red}");
        assert!(red.truncate().distance(green.truncate()) >= 2.0 * CUBE_HALF - 1e-4, "{off}: {red} {green}");
        assert!(green.distance(Vec3::new(0.0, 0.0, CUBE_HALF)) < 0.01, "{off}: {green}");
    }
}

#[test]
fn a_cube_dropped_from_high_lands_on_the_other() {
    let mut world = held_over(Vec2::ZERO);
    run(&mut world, [0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0], 4);
    run(&mut world, STAY_OPEN, 8);
    assert!(world.rests_on(0, 1), "{}", world.cube().position);
}

#[test]
fn a_held_cube_pushes_another_along_and_never_into_itself() {
    let mut world = around_cube(Vec3::ZERO, 0.0);
    run(&mut world, CLOSE, 4);
    world.cubes.push(Cube::resting(Vec3::new(0.07, 0.01, CUBE_HALF), 0.4));
    for _ in 0..6 {
        run(&mut world, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0], 1);
        let [red, green] = [0, 1].map(|cube| world.cubes[cube].position);
        assert!(world.holds_cube() && red.distance(green) >= 2.0 * CUBE_HALF - 1e-4, "{red} {green}");
    }
    assert!(world.cubes[1].position.x > 0.12, "{}", world.cubes[1].position);
    assert_eq!(world.cubes[1].position.z, CUBE_HALF);
}

#[test]
fn a_pushed_stack_goes_along_and_a_pulled_cube_takes_what_lies_on_it() {
    let mut world = stacked(Vec2::ZERO);
    world.tool = Tool::open(Vec3::new(-0.1, 0.0, 0.02), 0.0);
    world.tool.width = 0.0;
    run(&mut world, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0], 6);
    assert!(world.cubes[1].position.x > 0.02 && world.rests_on(0, 1), "{:?}", world.cubes);
    let mut world = stacked(Vec2::ZERO);
    world.cubes[0].yaw = GREEN_YAW;
    world.tool = Tool::open(world.cubes[1].position.with_z(0.032), GREEN_YAW);
    run(&mut world, CLOSE, 4);
    assert_eq!(world.held(), Some(1));
    run(&mut world, [0.5, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0], 4);
    assert!(world.cubes[1].position.z > 0.07);
    let rise = world.cubes[0].position - world.cubes[1].position;
    assert!((rise.z - 2.0 * CUBE_HALF).abs() < 1e-3, "{rise}");
}

#[test]
fn the_palm_stops_on_a_stack() {
    let mut world = stacked(Vec2::ZERO);
    run(&mut world, [0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 1.0], 12);
    let palm = world.tool.position.z - TIP_BELOW + 2.0 * FINGER_HALF_HEIGHT;
    assert!((palm - 4.0 * CUBE_HALF).abs() < 1e-5, "{palm}");
    assert!(world.rests_on(0, 1));
}
