//! Evaluation: a policy drives the embedded simulator in closed loop, with many attempts batched in one pass. Its metrics
//! are what the policy looked at in the first attempts, which may go where no expert went.

mod steps;

use gleaner_core::action::ActionRanges;
use gleaner_core::{EvaluateSpec, evaluation::SeedResult, work::Made};
use gleaner_learn::{Monitor as _, Observed, Policy, PolicySession, Trajectory};
use gleaner_recording::TaskSpec;
use gleaner_sim::{ACTION_SIZE, Observation, Sim, SimConfig, Task, simulated, task_spec};

use super::Work;
use crate::{failure::Failure, monitor::Watcher};
use steps::Steps;

/// Attempts that run at the same time.
const SIDE_BY_SIDE: usize = 32;

/// Runs the trials of every seed.
pub(super) fn perform(work: &mut Work, spec: &EvaluateSpec) -> Result<Made, Failure> {
    let checkpoint = work.input("policy", work.inputs.policy.as_ref())?;
    gleaner_learn::set_threads(work.threads);
    let mut policy = Policy::load_on(&checkpoint, spec.device)?;
    if spec.hide_history {
        policy = policy.hiding_history()?;
    }
    work.monitor.phase("evaluating");
    evaluate(&work.inputs.task, &policy, spec, &mut work.monitor).map(Made::Trials)
}

/// The results of every seed, in order. Each seed runs alone, so that its result does not depend on the others.
fn evaluate(
    task: &TaskSpec,
    policy: &Policy,
    spec: &EvaluateSpec,
    monitor: &mut Watcher,
) -> Result<Vec<SeedResult>, Failure> {
    let (simulation, config) =
        simulated(task, &spec.simulation).map_err(|error| Failure::Permanent(error.to_string()))?;
    let config = SimConfig { max_steps: spec.max_steps, ..config };
    let total = u64::from(spec.episodes) * spec.seeds.len() as u64;
    let mut episodes = Vec::new();
    let mut results = Vec::with_capacity(spec.seeds.len());
    for &seed in &spec.seeds {
        let before = u64::from(spec.episodes) * results.len() as u64;
        let ranges = ActionRanges::of(&task_spec(simulation, &config).action);
        let kept = steps::ATTEMPTS.saturating_sub(u32::try_from(episodes.len()).unwrap_or(u32::MAX));
        let trials =
            Trials { policy, simulation, config, ranges, kept, episodes: &mut episodes, tally: Tally::default() };
        let tally = trials.run(spec.attempts(seed), &mut |tally| {
            monitor.progress(before + u64::from(tally.episodes), total, &[]);
            if monitor.cancelled() { Err(Failure::Cancelled) } else { Ok(()) }
        })?;
        results.push(tally.result(seed));
    }
    let shares = policy.shares(&episodes, spec.seeds.first().copied().unwrap_or_default())?;
    monitor.progress(total, total, &shares);
    Ok(results)
}

/// The results of a seed so far.
#[derive(Debug, Clone, Copy, Default)]
struct Tally {
    episodes: u32,
    successes: u32,
    steps: u64,
}

impl Tally {
    fn add(&mut self, sim: &Sim) {
        self.episodes += 1;
        self.successes += u32::from(sim.success());
        self.steps += u64::from(sim.steps());
    }

    #[expect(clippy::cast_precision_loss, reason = "at most 10^10 steps")]
    fn result(self, seed: u64) -> SeedResult {
        let Self { episodes, successes, steps } = self;
        SeedResult { seed, episodes, successes, mean_steps: steps as f64 / f64::from(episodes.max(1)) }
    }
}

/// One running attempt.
struct Attempt {
    sim: Sim,
    session: PolicySession,
    /// The action of the step before.
    executed: Option<Vec<f32>>,
    /// Its steps, if it is one of those that are kept.
    steps: Option<Steps>,
}

/// The attempts of one seed.
struct Trials<'a> {
    policy: &'a Policy,
    simulation: Task,
    config: SimConfig,
    ranges: ActionRanges,
    /// Attempts whose steps are still to be kept.
    kept: u32,
    /// Those whose steps were kept.
    episodes: &'a mut Vec<Trajectory>,
    tally: Tally,
}

impl Trials<'_> {
    /// Runs every attempt; the next one starts when a place is free. `each` is called at every step and may return an
    /// error to stop.
    fn run(
        mut self,
        mut seeds: impl Iterator<Item = u64>,
        each: &mut dyn FnMut(&Tally) -> Result<(), Failure>,
    ) -> Result<Tally, Failure> {
        let mut running: Vec<Attempt> = Vec::with_capacity(SIDE_BY_SIDE);
        loop {
            let free = SIDE_BY_SIDE - running.len();
            for seed in seeds.by_ref().take(free) {
                running.push(self.begin(seed));
            }
            if running.is_empty() {
                return Ok(self.tally);
            }
            self.step(&mut running)?;
            for attempt in running.extract_if(.., |attempt| attempt.sim.done()) {
                self.tally.add(&attempt.sim);
                let steps = attempt.steps.map(|steps| steps.episode(self.policy.shape(), self.episodes.len()));
                self.episodes.extend(steps.transpose()?.flatten());
            }
            each(&self.tally)?;
        }
    }

    fn begin(&mut self, seed: u64) -> Attempt {
        let steps = (self.kept > 0).then(Steps::default);
        self.kept = self.kept.saturating_sub(1);
        Attempt {
            steps,
            sim: Sim::new(self.simulation, self.config, seed),
            session: self.policy.session(seed).within(self.ranges.clone()),
            executed: None,
        }
    }

    /// One control step of every attempt.
    fn step(&self, running: &mut [Attempt]) -> Result<(), Failure> {
        let seen: Vec<_> = running.iter().map(|attempt| attempt.sim.observe()).collect();
        let executed: Vec<_> = running.iter_mut().map(|attempt| attempt.executed.take()).collect();
        let steps: Vec<_> = seen.iter().zip(&executed).map(|(seen, executed)| [observed(seen, executed)]).collect();
        let sessions = running.iter_mut().map(|attempt| &mut attempt.session).zip(&steps);
        let mut sessions: Vec<_> = sessions.map(|(session, step)| (session, step.as_slice())).collect();
        let actions = self.policy.advance(&mut sessions)?;
        for ((attempt, seen), actions) in running.iter_mut().zip(&seen).zip(actions) {
            // The task's ranges are the simulator's, so this is the action that it executes.
            let action = actions.into_iter().next().unwrap_or_default();
            let command: &[f32; ACTION_SIZE] = action.as_slice().try_into().map_err(|_| {
                Failure::Permanent(format!(
                    "the policy gives {} values, the simulator takes {ACTION_SIZE}",
                    action.len()
                ))
            })?;
            attempt.sim.step(command);
            if let Some(steps) = &mut attempt.steps {
                steps.add(seen, command);
            }
            attempt.executed = Some(action);
        }
        Ok(())
    }
}

fn observed<'a>(seen: &'a Observation, executed: &'a Option<Vec<f32>>) -> Observed<'a> {
    Observed { frame: &seen.frames, proprioception: &seen.proprioception, executed: executed.as_deref() }
}
