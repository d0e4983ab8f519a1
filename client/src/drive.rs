//! Drive: closed-loop evaluation of a deployed policy in the embedded simulator, over the policy endpoint.
//!
//! One simulated episode is one session. By default it runs in lock step: simulated time waits for the policy, so that
//! the result does not depend on the machine's speed. In real time the episode is a robot in the control loop, and late
//! actions are late. Must not know training.

mod driven;

use std::time::{Duration, Instant};

use futures::{StreamExt as _, TryStreamExt as _};
use gleaner_proto::v1::{Outcome, SessionOpen};
use gleaner_recording::TaskSpec;
use gleaner_sim::{Sim, SimConfig};
use tokio::task::{JoinError, JoinHandle};

use crate::connection::Client;
use crate::error::{ClientError, Result};
use crate::lowest::Lowest;
use crate::robot::{ControlCause, ControlPlan, ControlReport, SimRobot};
use crate::session::{Session, observation};

pub use driven::{Driven, DrivenEpisode};

// Far longer than any policy takes: an upper bound for an evaluation.
const PATIENCE: Duration = Duration::from_secs(60);

/// The settings of an evaluation.
#[derive(Clone, Debug)]
pub struct DrivePlan {
    /// The deployment's name.
    pub deployment: String,
    /// The simulated task.
    pub task: gleaner_sim::Task,
    /// The simulator's settings; image size and rate must be those of the policy's training data.
    pub config: SimConfig,
    /// Number of episodes.
    pub episodes: u32,
    /// Episode i starts from seed + i, so that two policies are evaluated on the same episodes; a policy that draws its
    /// actions draws them under that seed, as in an evaluation by a job.
    pub seed: u64,
    /// Episodes that run at the same time.
    pub sessions: usize,
    /// Run in real time; else in lock step.
    pub real_time: Option<RealTime>,
    /// Record the episodes, labelled by the simulator's verdict.
    pub record: Option<Recorded>,
}

/// The settings of recorded episodes.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Recorded {
    /// The cohort of the episodes; empty: the deployment's name.
    pub cohort: String,
}

/// Time limits of a robot in real time; unset: the [`ControlPlan`]'s defaults.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RealTime {
    /// How long the server may take to answer an observation.
    pub deadline: Option<Duration>,
    /// How long the robot holds without a due action before it is stopped.
    pub hold_for: Option<Duration>,
}

/// A task that is cancelled when this is dropped, where tokio's own handle would leave it running.
struct Task<T>(JoinHandle<T>);

impl<T> Task<T> {
    /// Waits for its end.
    async fn end(mut self) -> std::result::Result<T, JoinError> {
        (&mut self.0).await
    }
}

impl<T> Drop for Task<T> {
    fn drop(&mut self) {
        self.0.abort();
    }
}

struct Run {
    episode: DrivenEpisode,
    policy_id: String,
    latencies: Vec<Duration>,
    control: Option<ControlReport>,
}

impl Client {
    /// Runs simulated episodes against a deployment, several at a time, and returns their results. `on_episode` is
    /// called as each one ends.
    ///
    /// # Errors
    /// The first session that fails ends the evaluation with its error, and so does a session of another policy than the
    /// earlier ones: the deployment was changed meanwhile. The other episodes are then abandoned, as they are when the future
    /// is dropped.
    pub async fn drive(&self, plan: &DrivePlan, mut on_episode: impl FnMut(&DrivenEpisode)) -> Result<Driven> {
        let started = Instant::now();
        let spec = gleaner_sim::task_spec(plan.task, &plan.config);
        let runs = (0..plan.episodes).map(|index| {
            let seed = plan.seed.wrapping_add(u64::from(index));
            let (client, plan, spec) = (self.clone(), plan.clone(), spec.clone());
            // Its own task, so that episodes are simulated and rendered on all cores.
            let run = Task(tokio::spawn(async move {
                match plan.real_time {
                    None => run_episode(&client, &plan, &spec, seed).await,
                    Some(pace) => run_in_real_time(&client, &plan, control_plan(&plan, &spec, pace, seed)?).await,
                }
            }));
            async move {
                let ended = run.end().await;
                ended.unwrap_or_else(|failed| Err(ClientError::Invalid(format!("episode {seed}: {failed}"))))
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
            driven.expect_policy(&plan.deployment, run.policy_id)?;
            on_episode(&run.episode);
            driven.episodes.push(run.episode);
            driven.latencies.extend(run.latencies);
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
    let open = SessionOpen {
        deployment: plan.deployment.clone(),
        record: plan.record.is_some(),
        cohort: plan.record.clone().unwrap_or_default().cohort,
        seed,
        ..SessionOpen::default()
    };
    let mut session = Session::open_with(client, open).await?;
    let (mut latencies, mut lowest) = (Vec::new(), Lowest::default());
    while !sim.done() {
        let seen = sim.observe();
        let observation = observation(spec, seen.stamp_ns, seen.frames, seen.proprioception)?;
        let sent = Instant::now();
        let answer = tokio::time::timeout(PATIENCE, session.act(observation)).await.map_err(|_| {
            ClientError::Invalid(format!(
                "{} returned no action within {} s; see the server's log",
                plan.deployment,
                PATIENCE.as_secs()
            ))
        })??;
        latencies.push(sent.elapsed());
        lowest.record(answer.observation_stamp_ns, answer.score.as_ref());
        let first = answer.actions.first().ok_or(ClientError::Contract { missing: "an action" })?;
        let action = first.values.as_slice().try_into().map_err(|_| {
            ClientError::Invalid(format!(
                "the policy of {} gives {} action values, the simulator takes 7; was the policy trained on this task?",
                plan.deployment,
                first.values.len()
            ))
        })?;
        sim.step(action);
    }
    let policy_id = session.opened().policy_id.clone();
    let closed = session.close_as(if sim.success() { Outcome::Success } else { Outcome::Failure }).await?;
    let episode_ids = Some(closed.episode_id).filter(|id| !id.is_empty()).into_iter().collect();
    let lowest = lowest.found();
    let episode = DrivenEpisode { seed, success: sim.success(), steps: sim.steps(), episode_ids, lowest };
    Ok(Run { episode, policy_id, latencies, control: None })
}

fn control_plan(plan: &DrivePlan, spec: &TaskSpec, pace: RealTime, seed: u64) -> Result<ControlPlan> {
    let mut control = ControlPlan { seed, ..ControlPlan::new(&plan.deployment, spec.rate_hz)? };
    control.deadline = pace.deadline.unwrap_or(control.deadline);
    control.lost_after = control.lost_after.max(control.deadline.saturating_mul(2));
    control.hold_for = pace.hold_for.unwrap_or(control.hold_for);
    if let Some(Recorded { cohort }) = plan.record.clone() {
        (control.record, control.cohort) = (true, cohort);
    }
    Ok(control)
}

async fn run_in_real_time(client: &Client, plan: &DrivePlan, control: ControlPlan) -> Result<Run> {
    let seed = control.seed;
    let mut robot = SimRobot::new(plan.task, plan.config, seed);
    let report =
        client.control(&mut robot, &control, std::future::pending()).await.map_err(|ended| match ended.cause {
            ControlCause::Robot(error) | ControlCause::Stop(error) | ControlCause::Client(error) => error,
        })?;
    let sim = robot.sim();
    let (episode_ids, lowest) = (report.episode_ids.clone(), report.lowest.clone());
    let episode = DrivenEpisode { seed, success: sim.success(), steps: sim.steps(), episode_ids, lowest };
    Ok(Run { episode, policy_id: report.policy_id.clone(), latencies: Vec::new(), control: Some(report) })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As the other episodes are after the first that fails.
    #[tokio::test]
    async fn an_episode_that_is_not_awaited_is_abandoned() {
        let (open, mut session) = tokio::sync::oneshot::channel::<()>();
        let (begun, begins) = tokio::sync::oneshot::channel();
        let run = Task(tokio::spawn(async move {
            begun.send(()).unwrap();
            std::future::pending::<()>().await;
            drop(open);
        }));
        begins.await.unwrap();
        assert_eq!(session.try_recv(), Err(tokio::sync::oneshot::error::TryRecvError::Empty));
        drop(run.end());
        assert!(session.await.is_err(), "what the episode holds is dropped");
        assert_eq!(Task(tokio::spawn(async { 7 })).end().await.unwrap(), 7);
    }

    #[test]
    fn unset_real_time_limits_are_the_plans_defaults() {
        let plan = DrivePlan {
            deployment: "a@b".into(),
            task: gleaner_sim::Task::PickCube,
            config: SimConfig::default(),
            episodes: 1,
            seed: 0,
            sessions: 1,
            real_time: None,
            record: Some(Recorded { cohort: "night".into() }),
        };
        let spec = gleaner_sim::task_spec(plan.task, &plan.config);
        let own = control_plan(&plan, &spec, RealTime::default(), 9).unwrap();
        assert_eq!((own.period, own.deadline), (Duration::from_millis(100), Duration::from_millis(100)));
        assert_eq!((own.record, own.cohort.as_str(), own.seed), (true, "night", 9));
        let message = RealTime { deadline: Some(Duration::from_secs(5)), hold_for: Some(Duration::ZERO) };
        let message = control_plan(&plan, &spec, message, 9).unwrap();
        assert_eq!((message.deadline, message.hold_for), (Duration::from_secs(5), Duration::ZERO));
        assert!(message.lost_after > message.deadline);
    }
}
