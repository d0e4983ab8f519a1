//! A running attempt: observations, actions and its end.
//!
//! This module does not depend on agents or files.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::config::SimConfig;
use crate::render;
use crate::task::{ACTION_SIZE, Referee, Task, proprioception};
use crate::world::{RATE_HZ, World};

/// Stamp of the first step: the beginning of 2026. It is fixed, so that a seed always gives the same bytes.
const FIRST_STAMP_NS: i64 = 1_767_225_600_000_000_000;
/// Nanoseconds between steps.
#[expect(clippy::cast_possible_truncation, reason = "a small whole number")]
const PERIOD_NS: i64 = (1e9 / RATE_HZ as f64) as i64;

/// The random streams of a seed; each kind of choice has its own, so that they are independent.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Stream {
    /// The initial state.
    World,
    /// The expert's habits.
    Expert,
    /// The fault of an imperfect agent.
    Fault,
    /// The false start of an agent.
    FalseStart,
}

/// The random numbers of one stream of a seed.
pub(crate) fn random(seed: u64, stream: Stream) -> ChaCha8Rng {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(match stream {
        Stream::World => 0,
        Stream::Expert => 1,
        Stream::Fault => 2,
        Stream::FalseStart => 3,
    });
    random
}

/// The input of a policy.
#[derive(Clone, Debug, PartialEq)]
pub struct Observation {
    /// Camera by camera (`table`, `hand`): H·W·3 RGB bytes, then H·W depths in millimetres as little-endian u16.
    pub frames: Vec<u8>,
    /// The values of the task's proprioception fields, in order.
    pub proprioception: Vec<f32>,
    /// The time of the observation, in nanoseconds since 1970.
    pub stamp_ns: i64,
}

/// An attempt at a task. It is a plain value that can be cloned and moved to any thread.
#[derive(Clone, Debug)]
pub struct Sim {
    task: Task,
    world: World,
    referee: Referee,
    config: SimConfig,
    steps: u32,
    success: bool,
}

impl Sim {
    /// Starts an attempt. The same task, settings and seed always give the same attempt.
    #[must_use]
    pub fn new(task: Task, config: SimConfig, seed: u64) -> Self {
        let world = (task.rules().begin)(&mut random(seed, Stream::World));
        Self { task, referee: Referee::new(&world), world, config, steps: 0, success: false }
    }

    /// Renders the cameras and reads the proprioception.
    #[must_use]
    pub fn observe(&self) -> Observation {
        Observation {
            frames: render::frames(&self.world, self.config.image_size()),
            proprioception: proprioception(&self.world),
            stamp_ns: FIRST_STAMP_NS + i64::from(self.steps) * PERIOD_NS,
        }
    }

    /// Acts for one control step of 0.1 s. Has no effect once the attempt is done.
    ///
    /// The values of the action are clamped to [−1, 1], and NaN counts as 0:
    /// - 0–2: tool displacement along x, y, z; 1 is 2 cm;
    /// - 3–5: tool rotation about x, y, z; 1 is 0.15 rad. The tool stays upright: only z turns it;
    /// - 6: gripper, below 0 closes, else opens.
    pub fn step(&mut self, action: &[f32; ACTION_SIZE]) {
        if self.done() {
            return;
        }
        self.world.step(action);
        self.steps += 1;
        self.success = self.referee.watch(self.task.rules(), &self.world);
    }

    /// The task.
    #[must_use]
    pub fn task(&self) -> Task {
        self.task
    }

    /// Whether the task has succeeded.
    #[must_use]
    pub fn success(&self) -> bool {
        self.success
    }

    /// Whether the attempt has ended, by success or at the step limit.
    #[must_use]
    pub fn done(&self) -> bool {
        self.success || self.steps >= self.config.max_steps
    }

    /// Steps acted so far.
    #[must_use]
    pub fn steps(&self) -> u32 {
        self.steps
    }

    /// The true state, for scripted agents.
    pub(crate) fn world(&self) -> &World {
        &self.world
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STAY: [f32; ACTION_SIZE] = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0];

    #[test]
    fn attempt_ends_at_the_step_limit() {
        let config = SimConfig { max_steps: 3, ..SimConfig::default() };
        let mut sim = Sim::new(Task::PickCube, config, 4);
        for _ in 0..3 {
            assert!(!sim.done());
            sim.step(&STAY);
        }
        assert!(sim.done() && !sim.success());
        let last = sim.observe();
        sim.step(&[1.0; ACTION_SIZE]);
        assert_eq!((sim.steps(), sim.observe()), (3, last));
    }

    #[test]
    fn seed_determines_the_attempt() {
        let observe = |seed| Sim::new(Task::PickCube, SimConfig::default(), seed).observe();
        assert_eq!(observe(7), observe(7));
        assert_ne!(observe(7).frames, observe(8).frames);
    }

    #[test]
    fn attempts_run_on_other_threads() {
        let sims: Vec<Sim> = (0..4).map(|seed| Sim::new(Task::StackCube, SimConfig::default(), seed)).collect();
        let step = |mut sim: Sim| {
            sim.step(&STAY);
            sim.observe()
        };
        let here: Vec<Observation> = sims.iter().cloned().map(step).collect();
        let threads: Vec<_> = sims.into_iter().map(|sim| std::thread::spawn(move || step(sim))).collect();
        let there: Vec<Observation> = threads.into_iter().map(|thread| thread.join().unwrap()).collect();
        assert_eq!(here, there);
    }

    #[test]
    fn steps_are_a_tenth_of_a_second_apart() {
        let mut sim = Sim::new(Task::PickCube, SimConfig::default(), 1);
        let first = sim.observe().stamp_ns;
        sim.step(&STAY);
        assert_eq!(sim.observe().stamp_ns - first, 100_000_000);
    }
}
