//! What the imperfect agents do wrong: each follows the expert's script until its fault shows.
//!
//! The grade scales the fault, from nothing at 0 to near-certain failure at 1.

use glam::{Vec2, Vec3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::expert::{Aim, Expert};
use super::{AgentKind, AgentSpec};
use crate::task::ACTION_SIZE;
use crate::world::{STEP_REACH, World};

/// How far off a grasp point is at grade 1, in metres.
const GRASP_OFF: std::ops::Range<f32> = 0.032..0.048;
/// How far off a carry target is at grade 1, in metres.
const GOAL_OFF: std::ops::Range<f32> = 0.05..0.10;
/// Steps that a wanderer heads for one point.
const LEG: u32 = 7;
/// Half-width of the noise at grade 1, in action units.
const NOISE: f32 = 2.4;

/// When things happen as the expert does the same attempt.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rehearsal {
    /// Steps of the whole attempt.
    pub(crate) steps: u32,
    /// The step at which the carry begins.
    pub(crate) carry: u32,
}

/// An agent that goes wrong.
#[derive(Clone, Debug)]
pub(crate) struct Fault {
    script: Expert,
    kind: AgentKind,
    grade: f32,
    /// The step from which the fault shows, for the kinds that wait for a step.
    from: u32,
    /// Where a wanderer heads; `None` while it follows the script.
    leg: Option<Vec3>,
    random: ChaCha8Rng,
}

impl Fault {
    /// An agent whose script has the habits of `habits` and whose fault is drawn from `random`.
    pub(crate) fn new(agent: AgentSpec, rehearsal: Rehearsal, habits: ChaCha8Rng, mut random: ChaCha8Rng) -> Self {
        let grade = single(agent.grade());
        let mut aim = Aim { grasp_off: Vec2::ZERO, goal_off: Vec2::ZERO, recovers: true };
        let heading = Vec2::from_angle(random.random_range(0.0..std::f32::consts::TAU));
        let part: f32 = random.random_range(0.0..1.0);
        let steps = rehearsal.steps as f32;
        let carry = rehearsal.carry as f32;
        let mut from = 0.0;
        match agent.kind() {
            AgentKind::Expert => {}
            AgentKind::MissedGrasp => {
                aim.grasp_off = heading * grade * random.random_range(GRASP_OFF);
                aim.recovers = false;
            }
            AgentKind::WrongGoal => {
                aim.goal_off = heading * grade * random.random_range(GOAL_OFF);
            }
            AgentKind::EarlyRelease => {
                // At grade 1 anywhere in the first third of the carry, at lower grades nearer its end.
                from = carry + 1.0 + (steps - carry) * (1.0 - grade * (1.0 - 0.33 * part));
                aim.recovers = false;
            }
            AgentKind::Freeze | AgentKind::Wander => from = steps * (0.1 + 0.7 * part),
            AgentKind::Noise => from = steps * 0.6 * part,
        }
        Self { script: Expert::aiming(aim, habits), kind: agent.kind(), grade, from: whole(from), leg: None, random }
    }

    /// The action of the given step.
    pub(crate) fn act(&mut self, step: u32, world: &World) -> [f32; ACTION_SIZE] {
        let mut action = self.script.act(world);
        if step < self.from {
            return action;
        }
        match self.kind {
            // These go wrong in their aim.
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

    /// Leg by leg towards a random point, or with the grade's chance not; the gripper follows the script.
    fn wander(&mut self, step: u32, world: &World, action: &mut [f32; ACTION_SIZE]) {
        if (step - self.from).is_multiple_of(LEG) {
            let x = self.random.random_range(-0.18..0.18);
            let y = self.random.random_range(-0.18..0.18);
            let z = self.random.random_range(0.05..0.22);
            let strays = self.random.random_range(0.0..1.0) < self.grade;
            self.leg = strays.then(|| Vec3::new(x, y, z));
        }
        if let Some(point) = self.leg {
            let delta = ((point - world.tool.position) / STEP_REACH * 0.6).clamp_length_max(0.9);
            action[..3].copy_from_slice(&delta.to_array());
            action[5] = 0.0;
        }
    }
}

#[expect(clippy::cast_possible_truncation, reason = "a grade needs no more digits")]
fn single(grade: f64) -> f32 {
    grade as f32
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a small positive step number")]
fn whole(step: f32) -> u32 {
    step as u32
}
