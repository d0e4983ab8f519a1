//! The control loop at a fixed rate: observe, send the observation, command the due action. It waits for the server for
//! at most the plan's part of a period.

use std::future::Future;

use gleaner_core::ensemble::Execution;
use gleaner_core::proto::action::ranges_from_proto;
use gleaner_proto::v1::{Observation, SessionAction};
use tokio::time::{Instant, timeout_at};

use super::guard::Guarded;
use super::session_task::{Event, SessionTask};
use super::ticks::{Clock, Ticks};
use super::{ActionBuffer, ControlCause, ControlError, ControlPlan, ControlReport, Link, Robot};
use crate::connection::Client;
use crate::error::ClientError;
use crate::lowest::Lowest;

impl Client {
    /// Controls a robot with a deployed policy until `until` completes, the robot has no more observations, or an error
    /// occurs; in every case the robot is stopped. The first tick is when the session is open.
    ///
    /// At each tick the robot is observed and the observation sent; one that the server has not taken yet is replaced
    /// by it. The answer is awaited for as long as the plan allows, and commanded. Without it, the action that earlier
    /// chunks predicted for this tick is commanded. Without that, the robot holds, and after
    /// [`hold_for`](ControlPlan::hold_for) it is stopped until an action arrives. A lost server is handled the same
    /// way; meanwhile the session is reopened, with growing pauses. Ticks that pass while the robot itself is busy are
    /// skipped.
    ///
    /// Dropping the future stops the robot, too.
    ///
    /// # Errors
    /// [`ControlError`] with the report so far: the robot failed; the server rejected the deployment or an observation;
    /// it is unreachable for longer than [`give_up_after`](ControlPlan::give_up_after); or the plan is invalid.
    pub async fn control<R: Robot>(
        &self,
        robot: &mut R,
        plan: &ControlPlan,
        until: impl Future<Output = ()>,
    ) -> Result<ControlReport, ControlError<R::Error>> {
        control(robot, self.clone(), plan, until).await
    }
}

/// As [`Client::control`], over any [`Link`].
///
/// # Errors
/// As [`Client::control`].
pub async fn control<R: Robot, L: Link>(
    robot: &mut R,
    link: L,
    plan: &ControlPlan,
    until: impl Future<Output = ()>,
) -> Result<ControlReport, ControlError<R::Error>> {
    let mut robot = Guarded::new(robot);
    let mut report = ControlReport::default();
    let ended = match plan.check() {
        Ok(()) => {
            let mut session_task = SessionTask::start(link, plan);
            let mut run = Run::new(&mut robot, &mut report, &mut session_task, plan);
            let ended = tokio::select! {
                biased;
                () = until => Ok(()),
                ended = run.ticks() => ended,
            };
            let lowest = run.lowest;
            // Before the session is closed: the robot is stopped before any step that takes time.
            let stopped = robot.stop();
            let closed = session_task.close(robot.outcome()).await;
            report.lowest = lowest.found();
            report.episode_ids.extend(closed.map(|closed| closed.episode_id).filter(|id| !id.is_empty()));
            end(ended, stopped)
        }
        Err(error) => end(Err(error.into()), robot.stop()),
    };
    match ended {
        Ok(()) => Ok(report),
        Err((cause, not_stopped)) => Err(ControlError { cause, not_stopped, report: Box::new(report) }),
    }
}

type Ended<E> = Result<(), ControlCause<E>>;

/// Combines the end of a run with the result of the stop after it.
fn end<E: std::error::Error>(ended: Ended<E>, stopped: Result<(), E>) -> Result<(), (ControlCause<E>, Option<E>)> {
    match ended {
        Ok(()) => stopped.map_err(|error| (ControlCause::Stop(error), None)),
        Err(cause) => Err((cause, stopped.err())),
    }
}

struct Run<'a, 'r, R: Robot> {
    robot: &'a mut Guarded<'r, R>,
    report: &'a mut ControlReport,
    session_task: &'a mut SessionTask,
    plan: &'a ControlPlan,
    buffer: ActionBuffer,
    /// Whether a session was ever opened, and whether one is open now.
    opened: bool,
    connected: bool,
    /// Whether the session is newer than the buffer's chunks.
    anew: bool,
    /// The stamps of the last observation and of the newest answered one.
    stamp_ns: Option<i64>,
    answered_ns: Option<i64>,
    /// The last command, and the last tick with an action from the policy.
    commanded: Option<Vec<f32>>,
    acted_at: Instant,
    lowest: Lowest,
}

impl<'a, 'r, R: Robot> Run<'a, 'r, R> {
    fn new(
        robot: &'a mut Guarded<'r, R>,
        report: &'a mut ControlReport,
        session_task: &'a mut SessionTask,
        plan: &'a ControlPlan,
    ) -> Self {
        let buffer = ActionBuffer::new(plan.period, plan.ensembling);
        let (opened, connected, anew) = (false, false, false);
        let (stamp_ns, answered_ns, commanded, acted_at) = (None, None, None, Instant::now());
        Self {
            robot,
            report,
            session_task,
            plan,
            buffer,
            opened,
            connected,
            anew,
            stamp_ns,
            answered_ns,
            commanded,
            acted_at,
            lowest: Lowest::default(),
        }
    }

    async fn ticks(&mut self) -> Ended<R::Error> {
        while !self.connected {
            let event = self.session_task.next().await;
            self.take(event)?;
        }
        let mut ticks = Ticks::new(self.plan.period);
        let clock = Clock::new();
        loop {
            let tick = ticks.next().await;
            self.report.overruns += u64::from(tick.skipped);
            let Some(mut observation) = self.robot.observe().map_err(ControlCause::Robot)? else {
                return Ok(());
            };
            observation.skipped_steps = observation.skipped_steps.saturating_add(tick.skipped);
            self.report.ticks += 1;
            let stamp_ns = self.send(observation, clock.stamp_ns(tick))?;
            self.listen(stamp_ns, tick.at + self.plan.answer_within).await?;
            self.act(stamp_ns, tick.at).map_err(ControlCause::Robot)?;
        }
    }

    /// Sends the observation and returns its stamp.
    fn send(&mut self, mut observation: Observation, now_ns: i64) -> Result<i64, ClientError> {
        if observation.stamp_ns == 0 {
            observation.stamp_ns = now_ns;
        }
        let stamp_ns = observation.stamp_ns;
        if let Some(before) = self.stamp_ns.replace(stamp_ns)
            && stamp_ns <= before
        {
            return Err(ClientError::Invalid(format!(
                "observation.stamp_ns: {stamp_ns} is not after {before}; stamp each observation when it is taken, or \
                 leave 0"
            )));
        }
        if observation.executed_action.is_empty() {
            observation.executed_action = self.commanded.clone().unwrap_or_default();
        }
        self.report.dropped += u64::from(self.session_task.offer(observation));
        Ok(stamp_ns)
    }

    /// Handles waiting events, and waits for the answer to this stamp until `until`.
    async fn listen(&mut self, stamp_ns: i64, until: Instant) -> Result<(), ClientError> {
        while let Some(event) = self.session_task.here() {
            self.take(event)?;
        }
        while self.connected && self.answered_ns != Some(stamp_ns) {
            match timeout_at(until, self.session_task.next()).await {
                Ok(event) => self.take(event)?,
                Err(_) => break,
            }
        }
        Ok(())
    }

    fn take(&mut self, event: Event) -> Result<(), ClientError> {
        match event {
            Event::Opened(opened) => {
                self.anew = std::mem::replace(&mut self.opened, true);
                self.report.reconnects += u64::from(self.anew);
                self.buffer.set_ranges(ranges_from_proto(&opened.action_ranges));
                self.buffer.set_execution(Execution::of_horizon(opened.execute_length));
                self.report.policy_id = opened.policy_id;
                self.connected = true;
            }
            Event::Action(action) => self.keep(action)?,
            Event::Missed(missed) => {
                self.report.missed += 1;
                self.report.dropped += missed.dropped;
                self.answered_ns = Some(missed.observation_stamp_ns);
            }
            Event::Draining => self.report.drains += 1,
            Event::Lost => self.connected = false,
            Event::Ended(error) => return Err(error),
        }
        Ok(())
    }

    fn keep(&mut self, action: SessionAction) -> Result<(), ClientError> {
        let stamp_ns = action.observation_stamp_ns;
        self.report.dropped += action.dropped;
        self.answered_ns = Some(stamp_ns);
        self.lowest.record(stamp_ns, action.score.as_ref());
        if std::mem::take(&mut self.anew) {
            // Another history, perhaps another policy: earlier predictions are invalid.
            self.buffer.clear();
        }
        self.buffer.push(stamp_ns, action.actions.into_iter().map(|step| step.values).collect())?;
        let now = self.stamp_ns.unwrap_or(stamp_ns);
        self.report.late += u64::from(!self.buffer.reaches(now));
        Ok(())
    }

    fn act(&mut self, stamp_ns: i64, at: Instant) -> Result<(), R::Error> {
        match self.buffer.due(stamp_ns) {
            Some(action) => {
                self.robot.command(&action)?;
                (self.commanded, self.acted_at) = (Some(action), at);
                self.report.acted += 1;
                Ok(())
            }
            None => self.hold(at),
        }
    }

    fn hold(&mut self, at: Instant) -> Result<(), R::Error> {
        let Some(last) = self.commanded.as_deref().filter(|_| !self.robot.resting()) else {
            self.report.rested += 1;
            return Ok(());
        };
        let hold = self.robot.hold_action(last);
        if at.duration_since(self.acted_at) < self.plan.hold_for {
            self.robot.command(&hold)?;
            self.report.held += 1;
        } else {
            self.robot.stop()?;
            self.report.stops += 1;
            self.report.rested += 1;
        }
        self.commanded = Some(hold);
        Ok(())
    }
}
