//! Grasp the red cube, put it on the green one and release it.

use glam::{Vec2, Vec3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::Rules;
use crate::world::{CUBE_HALF, Cube, Tool, World};

/// The indices of the red cube, which is moved, and of the green one below it.
const RED: usize = 0;
const GREEN: usize = 1;
/// Least distance of the two at the beginning, in metres: the open fingers fit between.
const APART: f32 = 0.09;
/// Cubes whose centres are farther apart than this, in metres, cannot touch in any rotation.
const BESIDE: f32 = 2.0 * std::f32::consts::SQRT_2 * CUBE_HALF;

pub(super) const RULES: Rules =
    Rules { goal_given: false, begin, place, sets_down: true, achieved: |world| world.rests_on(RED, GREEN) };

/// Both cubes within 10 cm of the middle, each turned its own way, the tool above the middle.
fn begin(random: &mut ChaCha8Rng) -> World {
    let mut spot =
        |reach: f32, z: f32| Vec3::new(random.random_range(-reach..reach), random.random_range(-reach..reach), z);
    let red = spot(0.10, CUBE_HALF);
    let mut green = spot(0.10, CUBE_HALF);
    while green.distance(red) < APART {
        green = spot(0.10, CUBE_HALF);
    }
    let mut tool = spot(0.06, 0.0);
    tool.z = random.random_range(0.13..0.19);
    let yaw = random.random_range(-0.2..0.2);
    let mut cube = |position| Cube::resting(position, random.random_range(-0.45..0.45));
    let (red, green) = (cube(red), cube(green));
    World::new(Tool::open(tool, yaw), red, &[green], None)
}

fn place(world: &World, off: Vec2) -> Vec3 {
    let green = world.cubes[GREEN].position;
    let z = if off.length() > BESIDE { CUBE_HALF } else { green.z + 2.0 * CUBE_HALF };
    (green.truncate() + off).extend(z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    #[test]
    fn the_cubes_begin_apart_within_reach_and_on_the_table() {
        for seed in 0..200 {
            let world = begin(&mut ChaCha8Rng::seed_from_u64(seed));
            let [red, green] = [RED, GREEN].map(|cube| world.cubes[cube].position);
            assert!(red.distance(green) >= APART, "seed {seed}");
            for cube in [red, green] {
                assert!(cube.truncate().abs().max_element() <= 0.10 && cube.z == CUBE_HALF, "seed {seed}");
            }
            assert!(!(RULES.achieved)(&world), "seed {seed}");
        }
    }

    #[test]
    fn wrong_place_is_on_the_table() {
        let world = begin(&mut ChaCha8Rng::seed_from_u64(1));
        assert_eq!(place(&world, Vec2::ZERO).z, 3.0 * CUBE_HALF);
        assert_eq!(place(&world, Vec2::X * 0.03).z, 3.0 * CUBE_HALF);
        assert_eq!(place(&world, Vec2::X * 0.07).z, CUBE_HALF);
    }

    #[test]
    fn red_on_green_within_half_an_edge_is_success_and_elsewhere_not() {
        let begun = begin(&mut ChaCha8Rng::seed_from_u64(1));
        let on = |x: f32, z: f32| {
            let mut world = begun.clone();
            let along = Vec2::from_angle(world.cubes[GREEN].yaw) * x;
            world.cubes[RED].position = world.cubes[GREEN].position + along.extend(z);
            (RULES.achieved)(&world)
        };
        assert!(on(0.0, 2.0 * CUBE_HALF));
        assert!(on(0.9 * CUBE_HALF, 2.0 * CUBE_HALF));
        assert!(!on(1.1 * CUBE_HALF, 2.0 * CUBE_HALF), "too far over the edge");
        assert!(!on(0.0, 2.2 * CUBE_HALF), "above it");
        assert!(!on(2.0 * CUBE_HALF, 0.0), "beside it");
    }
}
