//! Detects the success of an attempt by the rules of its task.

use glam::Vec3;

use super::Rules;
use crate::world::World;

/// A cube that moves less than this in a step counts as still, in metres.
const STILL: f32 = 0.012;
/// The number of consecutive steps in which the goal is reached and all cubes are still.
const SETTLED_STEPS: u32 = 2;

/// Detects [`Rules::achieved`] with every cube still.
#[derive(Clone, Debug)]
pub(crate) struct Referee {
    last: Vec<Vec3>,
    settled: u32,
}

impl Referee {
    /// Starts with this world.
    pub(crate) fn new(world: &World) -> Self {
        Self { last: places(world), settled: 0 }
    }

    /// Observes one step; true from the step on in which the task succeeds.
    pub(crate) fn watch(&mut self, rules: &Rules, world: &World) -> bool {
        if self.settled >= SETTLED_STEPS {
            return true;
        }
        let places = places(world);
        let still = places.iter().zip(&self.last).all(|(now, last)| now.distance(*last) < STILL);
        self.settled = if still && (rules.achieved)(world) { self.settled + 1 } else { 0 };
        self.last = places;
        self.settled >= SETTLED_STEPS
    }
}

fn places(world: &World) -> Vec<Vec3> {
    world.cubes.iter().map(|cube| cube.position).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::task::{GOAL_RADIUS, Task};
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    /// A pick-cube world with the cube at this distance from the goal.
    fn beside_goal(x: f32) -> World {
        let mut world = (Task::PickCube.rules().begin)(&mut ChaCha8Rng::seed_from_u64(1));
        world.cubes[0].position = world.goal.unwrap_or_default() + Vec3::X * x;
        world
    }

    #[test]
    fn success_needs_the_cube_still_at_the_goal_for_two_steps() {
        let rules = Task::PickCube.rules();
        let mut referee = Referee::new(&beside_goal(0.1));
        let mut world = beside_goal(0.02);
        assert!(!referee.watch(rules, &world), "it has just arrived");
        assert!(!referee.watch(rules, &world), "still for one step");
        assert!(referee.watch(rules, &world), "still for two steps");
        world.cubes[0].position = Vec3::ZERO;
        assert!(referee.watch(rules, &world), "success stays");
    }

    #[test]
    fn a_cube_beside_the_goal_fails() {
        let world = beside_goal(GOAL_RADIUS + 0.001);
        let mut referee = Referee::new(&world);
        assert!((0..5).all(|_| !referee.watch(Task::PickCube.rules(), &world)));
    }

    #[test]
    fn a_stack_with_a_moving_cube_fails() {
        let rules = Task::StackCube.rules();
        let mut world = (rules.begin)(&mut ChaCha8Rng::seed_from_u64(1));
        world.cubes[0].position = world.cubes[1].position + Vec3::Z * 0.045;
        let mut referee = Referee::new(&world);
        for _ in 0..4 {
            for cube in &mut world.cubes {
                cube.position.x += 0.02;
            }
            assert!(!referee.watch(rules, &world));
        }
        assert!(!referee.watch(rules, &world));
        assert!(referee.watch(rules, &world));
    }
}
