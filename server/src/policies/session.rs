//! One robot's running episode: remembers its history, answers its newest observation in time or says that it did
//! not, and counts what it passed over. Holds nothing that another session could touch.

use std::{pin::pin, sync::Arc, time::Duration};

use futures::{FutureExt as _, Stream, StreamExt as _, future::Fuse, future::FusedFuture as _};
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

use super::{
    due::{Due, late, passed},
    engine::Engine,
    model::Model,
    outlet::Outlet,
    pace::Seat,
    record::Record,
    turn::{Memory, turn},
};
use crate::{
    domain::{
        episode::Outcome,
        id::{EpisodeId, PolicyId, SessionId},
        observation::{Acted, Observation, SessionInput, SessionOutput},
        time::Millis,
    },
    error::{Error, Result},
    rollouts::Tally,
    scorers::Watch,
};

/// Most observations looked at before the newest is answered, so that a flood cannot stop the answers.
const LOOK_AHEAD: usize = 256;

/// How long the close of a recorded session may wait for its last scores.
const SCORED_WITHIN: Duration = Duration::from_secs(10);

/// What holds for a session from its beginning to its end.
#[derive(Debug, Clone)]
pub(super) struct Terms {
    pub(super) id: SessionId,
    /// One control step; `None`: the task's.
    pub(super) period: Option<Duration>,
    /// For observations that name no deadline themselves.
    pub(super) deadline: Option<Duration>,
    /// How long a robot that is owed nothing may say nothing.
    pub(super) idle: Duration,
    /// How long the session may go on once the server begins to stop.
    pub(super) drain: Duration,
}

/// A running session.
pub(super) struct Session<M: Model> {
    engine: Arc<Engine<M>>,
    seat: Seat,
    terms: Terms,
    record: Record,
    /// While no turn has it.
    watch: Option<Watch>,
    /// The newest observation, while it waits for the one before to be answered.
    pending: Option<(Observation, Due)>,
    /// The answer owed to what the model has; `None` once it was said to be missed.
    asked: Option<Due>,
    /// Control steps missed while they waited, to be told to the model.
    unseen: u64,
    /// The newest stamp.
    stamp_ns: Option<i64>,
    /// When the robot was last heard or answered.
    stirred: Instant,
    /// The robot has said its last, and perhaps how its episode ended.
    ended: Option<(Outcome, &'static str)>,
    tally: Tally,
}

impl<M: Model> Session<M> {
    pub(super) fn new(engine: Arc<Engine<M>>, terms: Terms, record: Record, watch: Option<Watch>) -> Self {
        Self {
            seat: engine.join(terms.period),
            engine,
            terms,
            record,
            watch,
            pending: None,
            asked: None,
            unseen: 0,
            stamp_ns: None,
            stirred: Instant::now(),
            ended: None,
            tally: Tally::default(),
        }
    }

    pub(super) fn policy_id(&self) -> &PolicyId {
        &self.engine.identity().policy_id
    }

    /// Serves the session until the robot closes it. However it ends, what was recorded is kept.
    ///
    /// # Errors
    /// Invalid for a bad observation; Cancelled when the robot is gone; Late when it neither says nor reads anything
    /// for too long; Unavailable when the server has stopped; whatever keeps its recording from being stored.
    pub(super) async fn run(
        mut self,
        inputs: impl Stream<Item = Result<SessionInput>> + Unpin,
        outlet: &Outlet,
        stopping: &CancellationToken,
    ) -> Result<()> {
        let ended = self.serve(inputs, outlet, stopping).await;
        if let Err(error) = &ended {
            self.record.break_off(error, self.tally);
        }
        ended
    }

    async fn serve(
        &mut self,
        mut inputs: impl Stream<Item = Result<SessionInput>> + Unpin,
        outlet: &Outlet,
        stopping: &CancellationToken,
    ) -> Result<()> {
        outlet.send(self.opened()).await?;
        let mut memory = Memory::new(self.watch.take());
        let mut busy = pin!(Fuse::terminated());
        let mut close_at = None;
        loop {
            if busy.is_terminated() {
                self.look_ahead(&mut inputs)?;
                if let Some((observation, due)) = self.pending.take() {
                    memory.unseen += std::mem::take(&mut self.unseen);
                    self.asked = Some(due.clone());
                    self.record.asks(due.stamp_ns);
                    self.seat.asks();
                    busy.set(turn(Arc::clone(&self.engine), memory.take(), observation, due).fuse());
                } else if let Some((outcome, how)) = self.ended {
                    self.watch_to_the_end(&mut memory).await;
                    let episode = self.record.close(outcome, how, self.tally).await?;
                    return outlet.send(self.closed(episode)).await;
                }
            }
            tokio::select! {
                biased;
                () = outlet.closed() => return Err(Outlet::gone()),
                () = stopping.cancelled(), if close_at.is_none() => {
                    close_at = Some(Instant::now() + self.terms.drain);
                    outlet.send(SessionOutput::Draining { close_at: Millis::now().after(self.terms.drain) }).await?;
                }
                () = passed(close_at) => {
                    return Err(Error::unavailable("the server is stopping; open the session again"));
                }
                turned = &mut busy, if !busy.is_terminated() => {
                    let (remembered, actions) = turned?;
                    memory = remembered;
                    self.record.turned(actions.is_some());
                    self.stirred = Instant::now();
                    if let Some(said) = self.settle(actions, &mut memory) {
                        outlet.send(said).await?;
                    }
                }
                () = late(self.asked.as_ref()) => {
                    let due = self.asked.take();
                    self.miss(due, outlet).await?;
                }
                () = late(self.pending.as_ref().map(|(_, due)| due)) => {
                    let due = self.pending.take().map(|(_, due)| due);
                    self.unseen += due.as_ref().map_or(0, |due| due.dropped + 1);
                    self.miss(due, outlet).await?;
                }
                () = passed(Some(self.stirred + self.terms.idle)), if busy.is_terminated() => {
                    let seconds = self.terms.idle.as_secs();
                    return Err(Error::late(format!("nothing came for {seconds} s; open the session again")));
                }
                input = inputs.next(), if self.ended.is_none() => self.take(input)?,
            }
        }
    }

    /// What to say of a turn that is over: its actions, if they are still of use and nothing was said yet.
    fn settle(&mut self, actions: Option<Vec<Vec<f32>>>, memory: &mut Memory<M::History>) -> Option<SessionOutput> {
        let score = self.record.scored(memory.watch.as_mut());
        memory.withheld = true;
        let due = self.asked.take()?;
        match actions {
            Some(actions) if !due.is_late() => {
                self.tally.answered += 1;
                memory.given = actions.first().cloned();
                memory.withheld = false;
                let Due { stamp_ns, dropped, stages, deadline: _ } = due;
                let policy_id = self.engine.identity().policy_id.clone();
                let acted = Acted { stamp_ns, actions, policy_id, timings: stages.timings() };
                self.record.commanded(&acted);
                Some(SessionOutput::Action { acted, dropped, score })
            }
            Some(_) | None => {
                self.tally.missed += 1;
                Some(due.missed())
            }
        }
    }

    /// Says at its deadline that an observation is missed, so that the robot need not wait to learn it.
    async fn miss(&mut self, due: Option<Due>, outlet: &Outlet) -> Result<()> {
        let Some(due) = due else { return Ok(()) };
        self.tally.missed += 1;
        outlet.send(due.missed()).await
    }

    fn opened(&self) -> SessionOutput {
        let identity = self.engine.identity();
        let (policy_id, task_id) = (identity.policy_id.clone(), identity.task_id.clone());
        SessionOutput::Opened { session_id: self.terms.id.clone(), policy_id, task_id }
    }

    fn closed(&self, episode_id: Option<EpisodeId>) -> SessionOutput {
        let Tally { answered, dropped, missed, unscored: _ } = self.tally;
        SessionOutput::Closed { observations: answered, dropped, missed, episode_id }
    }

    /// A recording holds the score of every segment, up to the last.
    async fn watch_to_the_end(&mut self, memory: &mut Memory<M::History>) {
        let Some(watch) = memory.watch.as_mut().filter(|_| self.record.is_on()) else { return };
        if let (0, false, Some(given)) = (memory.unseen, memory.withheld, &memory.given) {
            watch.executed(given);
        }
        // Whoever closes waits for the last scores, but not for a scorer that is stuck.
        let _ = tokio::time::timeout(SCORED_WITHIN, watch.settle()).await;
        self.tally.unscored = Some(watch.left_out());
        self.record.scored(Some(watch));
    }

    /// Takes what has come already, so that the newest is answered.
    fn look_ahead(&mut self, inputs: &mut (impl Stream<Item = Result<SessionInput>> + Unpin)) -> Result<()> {
        for _ in 0..LOOK_AHEAD {
            if self.ended.is_some() {
                break;
            }
            match inputs.next().now_or_never() {
                Some(input) => self.take(input)?,
                None => break,
            }
        }
        Ok(())
    }

    fn take(&mut self, input: Option<Result<SessionInput>>) -> Result<()> {
        self.stirred = Instant::now();
        match input.transpose()? {
            Some(SessionInput::Observation(observation)) => self.see(observation),
            Some(SessionInput::Open { .. }) => {
                Err(Error::invalid("open", "the session is open already; send observations, then close"))
            }
            Some(SessionInput::Close { outcome }) => {
                self.ended = Some((outcome, "closed"));
                Ok(())
            }
            None => {
                self.ended = Some((Outcome::Unknown, "ended without a close"));
                Ok(())
            }
        }
    }

    /// An observation takes the place of one that still waits.
    fn see(&mut self, observation: Observation) -> Result<()> {
        let stamp_ns = observation.stamp_ns;
        let before = self.stamp_ns.replace(stamp_ns);
        if let Some(before) = before
            && stamp_ns < before
        {
            let mend = format!("is {stamp_ns}, before the {before} of the observation before; stamps must not go back");
            return Err(Error::invalid("observation.stamp_ns", mend));
        }
        self.record.observed(&observation, before)?;
        let passed_over = self.pending.take().map(|(_, due)| due.dropped + 1);
        self.tally.dropped += u64::from(passed_over.is_some());
        let due = Due::for_observation(&observation, self.terms.deadline, passed_over.unwrap_or(0));
        self.pending = Some((observation, due));
        Ok(())
    }
}

#[cfg(test)]
mod tests;
