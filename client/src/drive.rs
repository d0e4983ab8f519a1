//! Drive: closed-loop evaluation of a deployed policy in the embedded simulator, over the policy endpoint.
//!
//! One simulated episode is one session. By default in lock step: simulated time waits for the policy, so that the
//! result says how good the policy is on any machine. In real time the episode is a robot in the control loop, and what
//! is late is late. Knows nothing of training or scores.

use std::time::{Duration, Instant};

use futures::{StreamExt as _, TryStreamExt as _};
use gleaner_recording::TaskSpec;
use gleaner_sim::{Sim, SimConfig, statistics};

use crate::connection::Client;
use crate::error::{ClientError, Result};
use crate::robot::{ControlCause, ControlPlan, ControlReport, SimRobot};
use crate::session::{Session, observation};

// Far longer than any policy takes; an evaluation must not wait for ever.
const PATIENCE: Duration = Duration::from_secs(60);

/// What to evaluate and how often.
#[derive(Clone, Debug)]
pub struct DrivePlan {
    /// The deployment's name.
    pub deployment: String,
    /// The simulated task.
    pub task: gleaner_sim::Task,
    /// The simulator's settings; image size and rate must be those that the policy was trained on.
    pub config: SimConfig,
    /// Number of episodes.
    pub episodes: u32,
    /// Episode i starts from seed + i, so that two policies meet the same episodes.
    pub seed: u64,
    /// Episodes that run at the same time.
    pub sessions: usize,
    /// Run in real time; else in lock step.
    pub real_time: Option<RealTime>,
}

/// How patient a robot in real time is; unset: the [`ControlPlan`]'s own.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RealTime {
    /// How long the server may take to answer an observation.
    pub deadline: Option<Duration>,
    /// How long the robot holds when no action is due before it is stopped.
    pub hold_for: Option<Duration>,
}

/// One simulated episode.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DrivenEpisode {
    /// The simulator's seed.
    pub seed: u64,
    /// Whether the task was solved.
    pub success: bool,
    /// Steps taken.
    pub steps: u32,
}

/// How an evaluation went.
#[derive(Clone, Debug)]
pub struct Driven {
    /// In the order of their seeds.
    pub episodes: Vec<DrivenEpisode>,
    /// The policy that acted.
    pub policy_id: String,
    /// From observation sent to action received, sorted; none in real time, where nobody waits for them.
    pub latencies: Vec<Duration>,
    /// Of the whole evaluation.
    pub wall: Duration,
    /// What happened in real time, over all episodes.
    pub control: Option<ControlReport>,
}

impl Driven {
    /// Episodes that were solved.
    #[must_use]
    pub fn successes(&self) -> u32 {
        self.episodes.iter().map(|episode| u32::from(episode.success)).sum()
    }

    /// Share of episodes that were solved, 0 when there were none.
    #[must_use]
    pub fn success_rate(&self) -> f64 {
        f64::from(self.successes()) / f64::from(self.total().max(1))
    }

    /// 95 % Wilson interval of the success rate.
    #[must_use]
    pub fn interval(&self) -> (f64, f64) {
        statistics::wilson(self.successes(), self.total())
    }

    /// Steps over all episodes.
    #[must_use]
    pub fn steps(&self) -> u64 {
        self.episodes.iter().map(|episode| u64::from(episode.steps)).sum()
    }

    /// The latency that a share (0 to 1) of the steps does not exceed (nearest rank).
    #[must_use]
    pub fn latency(&self, share: f64) -> Duration {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            clippy::cast_precision_loss,
            reason = "a share of a length is an index; the cast saturates"
        )]
        let rank = (share.clamp(0.0, 1.0) * self.latencies.len() as f64).ceil() as usize;
        self.latencies.get(rank.saturating_sub(1)).copied().unwrap_or_default()
    }

    fn total(&self) -> u32 {
        u32::try_from(self.episodes.len()).unwrap_or(u32::MAX)
    }
}

struct Run {
    episode: DrivenEpisode,
    policy_id: String,
    latencies: Vec<Duration>,
    control: Option<ControlReport>,
}

impl Client {
    /// Runs simulated episodes against a deployment, several at a time, and says how they went. `on_episode`
    /// is called as each one ends.
    ///
    /// # Errors
    /// The first session that breaks ends the evaluation with its error.
    pub async fn drive(&self, plan: &DrivePlan, mut on_episode: impl FnMut(&DrivenEpisode)) -> Result<Driven> {
        let started = Instant::now();
        let spec = gleaner_sim::task_spec(plan.task, &plan.config);
        let runs =
            (0..plan.episodes).map(|index| {
                let seed = plan.seed.wrapping_add(u64::from(index));
                let (client, plan, spec) = (self.clone(), plan.clone(), spec.clone());
                // Its own task, so that episodes are simulated and rendered on all cores.
                let run = tokio::spawn(async move {
                    match plan.real_time {
                        None => run_episode(&client, &plan, &spec, seed).await,
                        Some(pace) => run_in_real_time(&client, &plan, control_plan(&plan, &spec, pace)?, seed).await,
                    }
                });
                async move {
                    run.await.unwrap_or_else(|failed| Err(ClientError::Invalid(format!("episode {seed}: {failed}"))))
                }
            });
        let mut driven = Driven {
            episodes: Vec::new(),
            policy_id: String::new(),
            latencies: Vec::new(),
            wall: Duration::ZERO,
            control: None,
        };
        let mut runs = futures::stream::iter(runs).buffer_unordered(plan.sessions.max(1));
        while let Some(run) = runs.try_next().await? {
            on_episode(&run.episode);
            driven.episodes.push(run.episode);
            driven.latencies.extend(run.latencies);
            driven.policy_id = run.policy_id;
            if let Some(report) = run.control {
                driven.control.get_or_insert_default().add(&report);
            }
        }
        driven.episodes.sort_by_key(|episode| episode.seed);
        driven.latencies.sort_unstable();
        driven.wall = started.elapsed();
        Ok(driven)
    }
}

async fn run_episode(client: &Client, plan: &DrivePlan, spec: &TaskSpec, seed: u64) -> Result<Run> {
    let mut sim = Sim::new(plan.task, plan.config, seed);
    let mut session = Session::open(client, &plan.deployment).await?;
    let mut latencies = Vec::new();
    while !sim.done() {
        let seen = sim.observe();
        let observation = observation(spec, seen.stamp_ns, seen.frames, seen.proprioception)?;
        let sent = Instant::now();
        let answer = tokio::time::timeout(PATIENCE, session.act(observation)).await.map_err(|_| {
            ClientError::Invalid(format!(
                "{} gave no action in {} s; see the server's log",
                plan.deployment,
                PATIENCE.as_secs()
            ))
        })??;
        latencies.push(sent.elapsed());
        let first = answer.actions.first().ok_or(ClientError::Contract { missing: "an action" })?;
        let action = first.values.as_slice().try_into().map_err(|_| {
            ClientError::Invalid(format!(
                "the policy of {} gives {} action values, the simulator takes 7; was it trained on this task?",
                plan.deployment,
                first.values.len()
            ))
        })?;
        sim.step(action);
    }
    let policy_id = session.opened().policy_id.clone();
    session.close().await?;
    let episode = DrivenEpisode { seed, success: sim.success(), steps: sim.steps() };
    Ok(Run { episode, policy_id, latencies, control: None })
}

fn control_plan(plan: &DrivePlan, spec: &TaskSpec, pace: RealTime) -> Result<ControlPlan> {
    let mut control = ControlPlan::new(&plan.deployment, spec.rate_hz)?;
    control.deadline = pace.deadline.unwrap_or(control.deadline);
    control.lost_after = control.lost_after.max(control.deadline.saturating_mul(2));
    control.hold_for = pace.hold_for.unwrap_or(control.hold_for);
    Ok(control)
}

async fn run_in_real_time(client: &Client, plan: &DrivePlan, control: ControlPlan, seed: u64) -> Result<Run> {
    let mut robot = SimRobot::new(plan.task, plan.config, seed);
    let report =
        client.control(&mut robot, &control, std::future::pending()).await.map_err(|ended| match ended.cause {
            ControlCause::Robot(error) | ControlCause::Stop(error) | ControlCause::Client(error) => error,
        })?;
    let sim = robot.sim();
    let episode = DrivenEpisode { seed, success: sim.success(), steps: sim.steps() };
    Ok(Run { episode, policy_id: report.policy_id.clone(), latencies: Vec::new(), control: Some(report) })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn driven(outcomes: &[bool], latencies_ms: &[u64]) -> Driven {
        Driven {
            episodes: (0..).zip(outcomes).map(|(seed, &success)| DrivenEpisode { seed, success, steps: 10 }).collect(),
            policy_id: String::new(),
            latencies: latencies_ms.iter().map(|&ms| Duration::from_millis(ms)).collect(),
            wall: Duration::ZERO,
            control: None,
        }
    }

    #[test]
    fn a_real_robots_times_are_the_tasks_unless_said() {
        let plan = DrivePlan {
            deployment: "a@b".into(),
            task: gleaner_sim::Task::PickCube,
            config: SimConfig::default(),
            episodes: 1,
            seed: 0,
            sessions: 1,
            real_time: None,
        };
        let spec = gleaner_sim::task_spec(plan.task, &plan.config);
        let own = control_plan(&plan, &spec, RealTime::default()).unwrap();
        assert_eq!((own.period, own.deadline), (Duration::from_millis(100), Duration::from_millis(100)));
        let said = RealTime { deadline: Some(Duration::from_secs(5)), hold_for: Some(Duration::ZERO) };
        let said = control_plan(&plan, &spec, said).unwrap();
        assert_eq!((said.deadline, said.hold_for), (Duration::from_secs(5), Duration::ZERO));
        assert!(said.lost_after > said.deadline);
    }

    #[test]
    fn rates_and_percentiles_are_of_what_happened() {
        let result = driven(&[true, false, true, true], &(1..=100).collect::<Vec<_>>());
        assert_eq!((result.successes(), result.steps()), (3, 40));
        assert!((result.success_rate() - 0.75).abs() < 1e-12);
        let (low, high) = result.interval();
        assert!(low < 0.75 && 0.75 < high);
        assert_eq!(result.latency(0.5), Duration::from_millis(50));
        assert_eq!(result.latency(0.99), Duration::from_millis(99));
        assert_eq!(result.latency(1.0), Duration::from_millis(100));
    }

    #[test]
    fn nothing_driven_is_no_division_by_nothing() {
        let result = driven(&[], &[]);
        assert!(result.success_rate().abs() < f64::EPSILON);
        assert_eq!(result.latency(0.99), Duration::ZERO);
        assert_eq!(result.interval(), (0.0, 1.0));
    }
}
