//! Motion of cubes: falling, resting on one another, sliding off, pushing.
//!
//! Every cube is upright and all have one size. Cubes never tip over: a cube without support under its centre slides off.
//! This module does not depend on the gripper; a held cube is an index into the list.

use glam::{Vec2, Vec3};

use super::SUBSTEP_S;

/// Half a cube's edge.
pub(crate) const CUBE_HALF: f32 = 0.0225;
const EDGE: f32 = 2.0 * CUBE_HALF;
const GRAVITY: f32 = 9.81;
/// Heights closer than this are the same.
const LEVEL: f32 = 1e-3;
/// Distance that a cube without support slides off another per substep.
const SLIDE: f32 = 0.004;

/// A cube.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Cube {
    /// Its centre.
    pub(crate) position: Vec3,
    /// Turn about the vertical.
    pub(crate) yaw: f32,
    pub(super) velocity: Vec3,
}

impl Cube {
    /// A cube at rest.
    #[must_use]
    pub(crate) fn resting(position: Vec3, yaw: f32) -> Self {
        Self { position, yaw, velocity: Vec3::ZERO }
    }
}

/// Whether the upper cube lies on the lower one with its centre over it.
pub(super) fn rests_on(upper: &Cube, lower: &Cube) -> bool {
    (upper.position.z - lower.position.z - EDGE).abs() < LEVEL && is_over(upper, lower)
}

/// A cube goes along with the one it rests on; along the table only if nothing else has moved it there.
pub(super) fn ride(cubes: &mut [Cube], before: &[Cube], held: Option<usize>) {
    for rider in (0..cubes.len()).filter(|&rider| Some(rider) != held) {
        let support = before.iter().position(|lower| rests_on(&before[rider], lower));
        let Some(support) = support else { continue };
        let moved = cubes[support].position - before[support].position;
        let untouched = cubes[rider].position == before[rider].position;
        cubes[rider].position += if untouched { moved } else { Vec3::Z * moved.z };
    }
}

/// Moves a falling cube by one substep onto the cube or table below it; without support there it slides outwards.
pub(super) fn drop(cubes: &mut [Cube], index: usize) {
    let support = support(cubes, index);
    let floor = support.map_or(CUBE_HALF, |support| cubes[support].position.z + EDGE);
    let slide = match support {
        Some(support) if !is_over(&cubes[index], &cubes[support]) => overlap(&cubes[index], &cubes[support]),
        _ => None,
    };
    let cube = &mut cubes[index];
    if cube.position.z > floor {
        cube.velocity.z -= GRAVITY * SUBSTEP_S;
    } else {
        // Friction takes a sliding cube's speed within a few substeps.
        cube.velocity *= Vec3::new(0.5, 0.5, 0.0);
    }
    cube.position += cube.velocity * SUBSTEP_S;
    if cube.position.z <= floor {
        cube.position.z = floor;
        cube.velocity.z = 0.0;
        if let Some((outwards, depth)) = slide {
            // Slightly more than the overlap, so that rounding errors do not keep it in place.
            cube.position += (outwards * SLIDE.min(depth + 1e-5)).extend(0.0);
        }
    }
}

/// Separates overlapping cubes: the moving one pushes the other, and a held one always pushes.
pub(super) fn separate(cubes: &mut [Cube], before: &[Cube], held: Option<usize>) {
    for first in 0..cubes.len() {
        for second in first + 1..cubes.len() {
            let (a, b) = (&cubes[first], &cubes[second]);
            let beside = (a.position.z - b.position.z).abs() < EDGE - LEVEL;
            let Some((towards_first, depth)) = overlap(a, b).filter(|_| beside) else { continue };
            let travel = |index: usize| cubes[index].position.distance_squared(before[index].position);
            let first_pushes = held == Some(first) || (held != Some(second) && travel(first) >= travel(second));
            let (pushed, way) = if first_pushes { (second, -towards_first) } else { (first, towards_first) };
            cubes[pushed].position += (way * depth).extend(0.0);
        }
    }
}

/// The distance by which a carried cube must rise to rest on cubes that it has come down into.
pub(super) fn rise_onto(carried: &Cube, index: usize, before: &[Cube]) -> f32 {
    let others = before.iter().enumerate().filter(|(other, _)| *other != index);
    others
        .filter(|(_, other)| before[index].position.z >= other.position.z + EDGE - LEVEL)
        .filter(|(_, other)| overlap(carried, other).is_some())
        .map(|(_, other)| other.position.z + EDGE - carried.position.z)
        .fold(0.0, f32::max)
}

/// The highest cube that this one is above and overlaps with.
fn support(cubes: &[Cube], index: usize) -> Option<usize> {
    let cube = &cubes[index];
    let height = |other: &usize| cubes[*other].position.z;
    (0..cubes.len())
        .filter(|other| *other != index && cube.position.z >= height(other) + EDGE - LEVEL)
        .filter(|other| overlap(cube, &cubes[*other]).is_some())
        .max_by(|a, b| height(a).total_cmp(&height(b)))
}

/// Whether the upper cube's centre lies over the lower cube.
fn is_over(upper: &Cube, lower: &Cube) -> bool {
    let away = (upper.position - lower.position).truncate();
    Vec2::from_angle(-lower.yaw).rotate(away).abs().max_element() <= CUBE_HALF
}

/// The least way that frees the first cube from the second as seen from above: direction and length.
fn overlap(first: &Cube, second: &Cube) -> Option<(Vec2, f32)> {
    let away = (first.position - second.position).truncate();
    // The longest that can lie between two centres that touch.
    if away.length_squared() >= 2.0 * EDGE * EDGE {
        return None;
    }
    let turn = Vec2::from_angle(first.yaw - second.yaw);
    // Half the first cube's width along the second one's axis, and the other way round.
    let reach = CUBE_HALF * (1.0 + turn.x.abs() + turn.y.abs());
    let (a, b) = (Vec2::from_angle(first.yaw), Vec2::from_angle(second.yaw));
    let frees = [a, a.perp(), b, b.perp()].map(|axis| {
        let along = away.dot(axis);
        (axis * 1.0_f32.copysign(along), reach - along.abs())
    });
    let least = frees.into_iter().min_by(|x, y| x.1.total_cmp(&y.1))?;
    (least.1 > 0.0).then_some(least)
}
