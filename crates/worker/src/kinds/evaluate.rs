//! Evaluation: a policy drives the embedded simulator in closed loop, with many attempts batched in one pass. Its metrics
//! are what the policy looked at in the first attempts, which may go where no expert went.

mod steps;

use gleaner_core::action::ActionRanges;
use gleaner_core::{Block, EvaluateSpec, evaluation::SeedResult, work::Made};
use gleaner_learn::{Form, LearnError, Monitor as _, Observed, Peers, Policy, PolicySession, Shards, Trajectory};
use gleaner_recording::TaskSpec;
use gleaner_sim::{ACTION_SIZE, Observation, Sim, SimConfig, Task, simulated, task_spec};

use super::Work;
use crate::{failure::Failure, monitor::Watcher};
use steps::Steps;

/// Runs the trials of every seed; `None` for a rank that does not lead.
pub(super) fn perform(work: &mut Work, spec: &EvaluateSpec, mut peers: Peers) -> Result<Option<Made>, Failure> {
    let checkpoint = work.input("policy", work.inputs.policy.as_ref())?;
    gleaner_learn::set_threads(work.threads);
    let mut policy = Policy::load_on(&checkpoint, spec.device)?;
    if spec.hide_history {
        policy = policy.hiding_history()?;
    }
    work.monitor.phase("evaluating");
    let results = evaluate(&work.inputs.task, &policy, spec, (&mut peers, &mut work.monitor))?;
    Ok(results.map(Made::Trials))
}

/// The results of every seed, in order; `None` at a rank that does not lead. Ranks share the blocks of attempts.
fn evaluate(
    task: &TaskSpec,
    policy: &Policy,
    spec: &EvaluateSpec,
    (peers, monitor): (&mut Peers, &mut Watcher),
) -> Result<Option<Vec<SeedResult>>, Failure> {
    let (simulation, config) =
        simulated(task, &spec.simulation).map_err(|error| Failure::Permanent(error.to_string()))?;
    let config = SimConfig { max_steps: spec.max_steps, ..config };
    let ranges = ActionRanges::of(&task_spec(simulation, &config).action);
    let trials = Trials { policy, simulation, config, ranges };
    let blocks = spec.blocks();
    let sizes: Vec<usize> = blocks.iter().map(|block| block.attempts.clone().count()).collect();
    let total = u64::from(spec.episodes) * spec.seeds.len() as u64;
    let mut kept = Vec::new();
    let mut shards = Shards::new(peers, &mut *monitor, total, None);
    let tallies = shards.at_lead(&sizes, &TALLY, |shards, item| {
        // The lead does the first block.
        let keep = if item == 0 { steps::ATTEMPTS } else { 0 };
        let (tally, steps) = trials.run(&blocks[item], keep, &mut |ended| shards.advance(ended))?;
        kept.extend(steps);
        Ok(tally)
    })?;
    let Some(tallies) = tallies else { return Ok(None) };
    let shares = policy.shares(&kept, spec.seeds.first().copied().unwrap_or_default())?;
    monitor.progress(total, total, &shares);
    Ok(Some(of_seeds(spec, &blocks, &tallies)))
}

/// The results of every seed, of the tallies of its blocks.
fn of_seeds(spec: &EvaluateSpec, blocks: &[Block], tallies: &[Tally]) -> Vec<SeedResult> {
    let mut sums = vec![Tally::default(); spec.seeds.len()];
    for (block, tally) in blocks.iter().zip(tallies) {
        sums[block.seed_index] += *tally;
    }
    sums.into_iter().zip(&spec.seeds).map(|(tally, seed)| tally.result(*seed)).collect()
}

/// The results of some attempts.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct Tally {
    episodes: u32,
    successes: u32,
    steps: u64,
}

/// A tally as three numbers.
const TALLY: Form<'static, Tally> = Form {
    write: &|Tally { episodes, successes, steps }| {
        Ok([u64::from(*episodes), u64::from(*successes), *steps].map(u64::to_le_bytes).concat())
    },
    read: &|_, bytes| {
        let (numbers, rest) = bytes.as_chunks();
        let [episodes, successes, steps] = *numbers else { return None };
        let number = |bytes| u32::try_from(u64::from_le_bytes(bytes)).ok();
        let tally =
            Tally { episodes: number(episodes)?, successes: number(successes)?, steps: u64::from_le_bytes(steps) };
        rest.is_empty().then_some(tally)
    },
};

impl std::ops::AddAssign for Tally {
    fn add_assign(&mut self, other: Self) {
        self.episodes += other.episodes;
        self.successes += other.successes;
        self.steps += other.steps;
    }
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

/// Attempts of a policy in a simulated task.
struct Trials<'a> {
    policy: &'a Policy,
    simulation: Task,
    config: SimConfig,
    ranges: ActionRanges,
}

impl Trials<'_> {
    /// Runs the attempts of a block side by side. Returns their results and the steps of the first `keep`. `each` takes how
    /// many ended at every step, and may return an error to stop.
    fn run(
        &self,
        block: &Block,
        keep: usize,
        each: &mut dyn FnMut(usize) -> Result<(), LearnError>,
    ) -> Result<(Tally, Vec<Trajectory>), LearnError> {
        let begin = |(place, seed)| self.begin(seed, place < keep);
        let mut running: Vec<Attempt> = block.attempts.clone().enumerate().map(begin).collect();
        let (mut tally, mut kept) = (Tally::default(), Vec::new());
        while !running.is_empty() {
            self.step(&mut running)?;
            let before = running.len();
            for attempt in running.extract_if(.., |attempt| attempt.sim.done()) {
                tally.add(&attempt.sim);
                let steps = attempt.steps.map(|steps| steps.episode(self.policy.shape(), kept.len()));
                kept.extend(steps.transpose()?.flatten());
            }
            each(before - running.len())?;
        }
        Ok((tally, kept))
    }

    fn begin(&self, seed: u64, keep: bool) -> Attempt {
        Attempt {
            steps: keep.then(Steps::default),
            sim: Sim::new(self.simulation, self.config, seed),
            session: self.policy.session(seed).within(self.ranges.clone()),
            executed: None,
        }
    }

    /// One control step of every attempt.
    fn step(&self, running: &mut [Attempt]) -> Result<(), LearnError> {
        let seen: Vec<_> = running.iter().map(|attempt| attempt.sim.observe()).collect();
        let executed: Vec<_> = running.iter_mut().map(|attempt| attempt.executed.take()).collect();
        let steps: Vec<_> = seen.iter().zip(&executed).map(|(seen, executed)| [observed(seen, executed)]).collect();
        let sessions = running.iter_mut().map(|attempt| &mut attempt.session).zip(&steps);
        let mut sessions: Vec<_> = sessions.map(|(session, step)| (session, step.as_slice())).collect();
        let actions = self.policy.advance(&mut sessions)?;
        for ((attempt, seen), actions) in running.iter_mut().zip(&seen).zip(actions) {
            // The task's ranges are the simulator's, so this is the action that it executes.
            let action = actions.into_iter().next().unwrap_or_default();
            let command: &[f32; ACTION_SIZE] = action.as_slice().try_into().map_err(|_| LearnError::Invalid {
                field: "policy".into(),
                message: format!("gives {} values, the simulator takes {ACTION_SIZE}", action.len()),
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tally_keeps_its_numbers_and_cut_bytes_are_none() {
        let tally = Tally { episodes: 64, successes: u32::MAX, steps: u64::MAX };
        let bytes = (TALLY.write)(&tally).unwrap();
        assert_eq!((TALLY.read)(0, &bytes), Some(tally));
        assert_eq!((TALLY.read)(0, &bytes[..23]), None);
        assert_eq!((TALLY.read)(0, &[bytes.as_slice(), &[0]].concat()), None);
    }

    #[test]
    fn a_seed_has_the_sum_of_its_blocks() {
        let spec = EvaluateSpec { episodes: 100, seeds: vec![8, 3], ..EvaluateSpec::default() };
        let of = |successes, steps| Tally { episodes: 50, successes, steps };
        let results = of_seeds(&spec, &spec.blocks(), &[of(1, 100), of(20, 200), of(0, 50), of(50, 350)]);
        let result = |seed, successes, mean_steps| SeedResult { seed, episodes: 100, successes, mean_steps };
        assert_eq!(results, [result(8, 21, 3.0), result(3, 50, 4.0)]);
    }
}
