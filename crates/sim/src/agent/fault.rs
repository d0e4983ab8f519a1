//! The faults of the imperfect agents: each follows the expert's script until its fault takes effect.
//!
//! The grade scales the fault, from nothing at 0 to near-certain failure at 1.

use glam::{Vec2, Vec3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::expert::{Aim, Expert};
use super::{AgentKind, AgentSpec, drift};
use crate::task::{ACTION_SIZE, Task};
use crate::world::World;

/// The error of a grasp point at grade 1, in metres.
const GRASP_OFF: std::ops::Range<f32> = 0.032..0.048;
/// The error of a carry target at grade 1, in metres.
const GOAL_OFF: std::ops::Range<f32> = 0.15..0.22;
/// The largest coordinate of a wrong target along either axis, in metres: within the reach of the hand.
const GOAL_REACH: f32 = 0.18;
/// Half-width of the noise at grade 1, in action units.
const NOISE: f32 = 2.4;

/// The times of events in the expert's run of the same attempt.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rehearsal {
    /// The first step of its script: 0 without a false start.
    pub(crate) begin: u32,
    /// Steps of the whole attempt.
    pub(crate) steps: u32,
    /// The step at which the carry begins.
    pub(crate) carry: u32,
    /// The step after the carry.
    pub(crate) carry_end: u32,
    /// The place of the cube.
    pub(crate) place: Vec2,
}

/// An agent with a fault.
#[derive(Clone, Debug)]
pub(crate) struct Fault {
    script: Expert,
    kind: AgentKind,
    grade: f32,
    /// The first step of the fault, for the kinds that start at a step.
    from: u32,
    /// The target of a wandering agent; `None` while it follows the script.
    leg: Option<Vec3>,
    random: ChaCha8Rng,
}

impl Fault {
    /// An agent whose script has the habits of `habits` and whose fault is drawn from `random`.
    pub(crate) fn new(
        task: Task,
        agent: AgentSpec,
        rehearsal: Rehearsal,
        habits: ChaCha8Rng,
        mut random: ChaCha8Rng,
    ) -> Self {
        let grade = single(agent.grade());
        let mut aim = Aim::default();
        let heading = Vec2::from_angle(random.random_range(0.0..std::f32::consts::TAU));
        let part: f32 = random.random_range(0.0..1.0);
        let (begin, steps) = (rehearsal.begin as f32, (rehearsal.steps - rehearsal.begin) as f32);
        let mut from = begin;
        match agent.kind() {
            AgentKind::Expert => {}
            AgentKind::MissedGrasp => {
                aim.grasp_off = heading * grade * random.random_range(GRASP_OFF);
                aim.recovers = grade == 0.0;
            }
            AgentKind::WrongGoal => {
                let off = random.random_range(GOAL_OFF) * grade.powf(2.5);
                aim.goal_off = within_reach(rehearsal.place, heading * off);
            }
            AgentKind::EarlyRelease => {
                let (carry, end) = (rehearsal.carry as f32, rehearsal.carry_end as f32);
                let begin = carry + 1.0 + (end - carry) * part * release_spread(grade);
                from = if grade > 0.0 { begin } else { f32::INFINITY };
                aim.recovers = grade == 0.0;
            }
            AgentKind::Freeze | AgentKind::Wander => from = begin + steps * (0.1 + 0.7 * part),
            AgentKind::Noise => from = begin + steps * 0.6 * part,
        }
        let script = Expert::aiming(task, aim, habits);
        Self { script, kind: agent.kind(), grade, from: whole(from), leg: None, random }
    }

    /// The action of the given step.
    pub(crate) fn act(&mut self, step: u32, world: &World) -> [f32; ACTION_SIZE] {
        let mut action = self.script.act(world);
        if step < self.from {
            return action;
        }
        match self.kind {
            // The fault of these kinds is in their aim.
            AgentKind::Expert | AgentKind::MissedGrasp | AgentKind::WrongGoal => {}
            AgentKind::EarlyRelease => action[6] = 1.0,
            AgentKind::Freeze => {
                for delta in &mut action[..6] {
                    *delta *= (1.0 - self.grade) * (1.0 - self.grade);
                }
            }
            AgentKind::Wander => self.wander(step, world, &mut action),
            AgentKind::Noise => {
                let spread = self.grade * NOISE;
                for delta in &mut action[..6] {
                    let noise: f32 = self.random.random_range(-1.0..1.0);
                    *delta = (*delta + spread * noise).clamp(-1.0, 1.0);
                }
            }
        }
        action
    }

    /// In each leg, moves towards a random point with a probability of the grade; the gripper follows the script.
    fn wander(&mut self, step: u32, world: &World, action: &mut [f32; ACTION_SIZE]) {
        if (step - self.from).is_multiple_of(drift::LEG) {
            let point = drift::point(&mut self.random);
            let strays = self.random.random_range(0.0..1.0) < self.grade;
            self.leg = strays.then_some(point);
        }
        if let Some(point) = self.leg {
            drift::towards(point, world, action);
        }
    }
}

/// The offset, rotated by quarter turns until its target is within reach.
fn within_reach(place: Vec2, off: Vec2) -> Vec2 {
    let turned = std::iter::successors(Some(off), |off| Some(off.perp())).take(4);
    turned.into_iter().find(|off| (place + *off).abs().max_element() < GOAL_REACH).unwrap_or(off)
}

/// The share of the carry in which the fingers open: its first third at grade 1; at a low grade mostly after its end, so
/// that the fault has no effect.
fn release_spread(grade: f32) -> f32 {
    0.33 + 1.5 * (1.0 / grade.max(1e-3) - 1.0)
}

#[expect(clippy::cast_possible_truncation, reason = "a grade needs no more digits")]
fn single(grade: f64) -> f32 {
    grade as f32
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a positive step number, or never")]
fn whole(step: f32) -> u32 {
    step as u32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::{Stream, random};

    /// Whether the agent's actions equal the expert's over an attempt in which the cube is taken away from the closing
    /// fingers, so that the expert tries again.
    fn equals_the_expert_after_a_miss(task: Task, agent: AgentSpec, seed: u64) -> bool {
        let mut world = (task.rules().begin)(&mut random(seed, Stream::World));
        let (habits, place) = (random(seed, Stream::Expert), (task.rules().place)(&world, Vec2::ZERO).truncate());
        let rehearsal = Rehearsal { begin: 0, steps: 60, carry: 10, carry_end: 20, place };
        let mut expert = Expert::new(task, habits.clone());
        let mut fault = Fault::new(task, agent, rehearsal, habits, random(seed, Stream::Fault));
        let mut missed = false;
        (0..60).all(|step| {
            let (expected, action) = (expert.act(&world), fault.act(step, &world));
            if !missed && expected[6] < 0.0 {
                world.cubes[0].position.x += 0.06_f32.copysign(-world.cubes[0].position.x);
                missed = true;
            }
            world.step(&expected);
            action == expected
        })
    }

    #[test]
    fn grade_0_is_the_expert_also_after_a_miss() {
        for (task, kind) in Task::ALL.into_iter().flat_map(|task| AgentKind::ALL.map(|kind| (task, kind))) {
            let none = AgentSpec::new(kind, 0.0).unwrap();
            for seed in 0..20 {
                assert!(equals_the_expert_after_a_miss(task, none, seed), "{task} {kind}, seed {seed}");
            }
        }
    }

    #[test]
    fn fingers_that_release_at_grade_0_never_open_early() {
        let agent = AgentSpec::new(AgentKind::EarlyRelease, 0.0).unwrap();
        let rehearsal = Rehearsal { begin: 0, steps: 60, carry: 10, carry_end: 20, place: Vec2::ZERO };
        for seed in 0..5_000 {
            let [habits, draw] = [Stream::Expert, Stream::Fault].map(|stream| random(seed, stream));
            let fault = Fault::new(Task::PickCube, agent, rehearsal, habits, draw);
            assert!(fault.from > rehearsal.steps, "seed {seed}: from step {}", fault.from);
        }
    }
}
