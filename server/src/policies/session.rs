//! One robot's running session: keeps its history, answers its newest observation by the deadline or reports it missed,
//! and counts dropped ones. Shares no state with other sessions.

use std::{pin::pin, sync::Arc, time::Duration};

use futures::{FutureExt as _, Stream, StreamExt as _, future::Fuse, future::FusedFuture as _};
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

use super::{
    engine::Engine,
    inference_step::{Memory, StepAnswer, inference_step},
    model::{Begin, Model},
    pending_reply::{PendingReply, late, passed},
    record::Record,
    reply_sender::ReplySender,
    session_rates::RateGuard,
    waiting::{Taken, Waiting},
};
use crate::{
    domain::{
        episode::Outcome,
        id::{EpisodeId, PolicyId, SessionId},
        observation::{Acted, Observation, SessionInput, SessionOutput, SessionSettings},
        time::Millis,
    },
    error::{Error, Result},
    rollouts::ObservationCounts,
    scorers::Watch,
};

/// The most observations read before the newest is answered, so that a flood cannot stop the answers.
const LOOK_AHEAD: usize = 256;

/// How long the close of a recorded session may wait for its last scores.
const SCORED_WITHIN: Duration = Duration::from_secs(10);

/// The id, the robot's settings and the server's limits, which hold for the whole session.
#[derive(Debug, Clone)]
pub(super) struct Terms {
    pub(super) id: SessionId,
    pub(super) settings: SessionSettings,
    /// How long a robot without a pending reply may send nothing.
    pub(super) idle: Duration,
    /// How long the session may continue once the server begins to stop.
    pub(super) drain: Duration,
}

/// A running session.
pub(super) struct Session<M: Model> {
    engine: Arc<Engine<M>>,
    guard: RateGuard,
    terms: Terms,
    record: Record,
    /// `None` while an inference step holds it.
    watch: Option<Watch>,
    /// The newest observation, waiting for the previous one to be answered.
    waiting: Waiting,
    /// The pending reply to the observation in the model; `None` once it was reported missed.
    in_flight: Option<PendingReply>,
    /// The newest stamp.
    stamp_ns: Option<i64>,
    /// The time of the last input or answer.
    stirred: Instant,
    /// Set by the robot's close: the outcome of its episode.
    ended: Option<(Outcome, &'static str)>,
    counts: ObservationCounts,
}

impl<M: Model> Session<M> {
    pub(super) fn new(engine: Arc<Engine<M>>, terms: Terms, record: Record, watch: Option<Watch>) -> Self {
        let rate_hz = terms.settings.control_rate_hz;
        let period = rate_hz.map(|hertz| Duration::try_from_secs_f64(1.0 / hertz).unwrap_or(Duration::MAX));
        Self {
            guard: engine.join(period),
            engine,
            terms,
            record,
            watch,
            waiting: Waiting::default(),
            in_flight: None,
            stamp_ns: None,
            stirred: Instant::now(),
            ended: None,
            counts: ObservationCounts::default(),
        }
    }

    pub(super) fn terms(&self) -> &Terms {
        &self.terms
    }

    pub(super) fn policy_id(&self) -> &PolicyId {
        &self.engine.identity().policy_id
    }

    /// Serves the session until the robot closes it. However it ends, its recording is kept.
    ///
    /// # Errors
    /// Invalid for a bad observation; Cancelled when the robot is gone; Late when it sends or reads nothing for too
    /// long; Unavailable when the server has stopped; any error of storing its recording.
    pub(super) async fn run(
        mut self,
        inputs: impl Stream<Item = Result<SessionInput>> + Unpin,
        replies: &ReplySender,
        stopping: &CancellationToken,
    ) -> Result<()> {
        let ended = self.serve(inputs, replies, stopping).await;
        if let Err(error) = &ended {
            self.record.break_off(error, self.counts);
        }
        ended
    }

    async fn serve(
        &mut self,
        mut inputs: impl Stream<Item = Result<SessionInput>> + Unpin,
        replies: &ReplySender,
        stopping: &CancellationToken,
    ) -> Result<()> {
        replies.send(self.opened()).await?;
        let SessionSettings { seed, new_chunks, .. } = self.terms.settings;
        let begin = Begin { seed, new_chunks };
        let mut memory = Memory::new(begin, self.watch.take());
        let mut busy = pin!(Fuse::terminated());
        let mut close_at = None;
        loop {
            if busy.is_terminated() {
                self.look_ahead(&mut inputs)?;
                if let Some(Taken { observation, reply, unseen, after }) = self.waiting.take() {
                    memory.pass_over(unseen, after);
                    self.in_flight = Some(reply.clone());
                    self.record.inference_started(reply.stamp_ns);
                    self.guard.record_request();
                    busy.set(inference_step(Arc::clone(&self.engine), memory.take(), observation, reply).fuse());
                } else if let Some((outcome, how)) = self.ended {
                    self.settle_scores(&mut memory).await;
                    let episode = self.record.close(outcome, how, self.counts).await?;
                    return replies.send(self.closed(episode)).await;
                }
            }
            tokio::select! {
                biased;
                () = replies.closed() => return Err(ReplySender::gone()),
                () = stopping.cancelled(), if close_at.is_none() => {
                    close_at = Some(Instant::now() + self.terms.drain);
                    replies.send(SessionOutput::Draining { close_at: Millis::now().after(self.terms.drain) }).await?;
                }
                () = passed(close_at) => {
                    return Err(Error::unavailable("the server is stopping; open the session again"));
                }
                result = &mut busy, if !busy.is_terminated() => {
                    let (remembered, answer) = result?;
                    memory = remembered;
                    self.record.inference_finished(matches!(answer, StepAnswer::Acted(_)));
                    self.stirred = Instant::now();
                    if let Some(output) = self.settle(answer, &mut memory) {
                        replies.send(output).await?;
                    }
                }
                () = late(self.in_flight.as_ref()) => {
                    let reply = self.in_flight.take();
                    self.miss(reply, replies).await?;
                }
                () = late(self.waiting.reply()) => {
                    let reply = self.waiting.miss();
                    self.miss(reply, replies).await?;
                }
                () = passed(Some(self.stirred + self.terms.idle)), if busy.is_terminated() => {
                    let seconds = self.terms.idle.as_secs();
                    return Err(Error::late(format!("no message was received for {seconds} s; open the session again")));
                }
                input = inputs.next(), if self.ended.is_none() => self.take(input)?,
            }
        }
    }

    /// The output for a finished inference step: its actions if still in time, unless it was reported missed already.
    fn settle(&mut self, answer: StepAnswer, memory: &mut Memory<M::History>) -> Option<SessionOutput> {
        let score = self.record.scored(memory.watch.as_mut());
        // The newest observation in the history has an action unless the model advanced in vain.
        memory.withheld |= matches!(answer, StepAnswer::Acted(_));
        let reply = self.in_flight.take()?;
        match answer {
            StepAnswer::Acted(actions) if !reply.is_late() => {
                self.counts.answered += 1;
                memory.given = actions.first().cloned();
                memory.withheld = false;
                let PendingReply { stamp_ns, dropped, stages, deadline: _ } = reply;
                let policy_id = self.engine.identity().policy_id.clone();
                let acted = Acted { stamp_ns, actions, policy_id, timings: stages.timings() };
                self.record.commanded(&acted);
                Some(SessionOutput::Action { acted, dropped, score })
            }
            StepAnswer::Acted(_) => {
                self.counts.missed += 1;
                Some(reply.missed(String::new()))
            }
            StepAnswer::Missed(reason) => {
                self.counts.missed += 1;
                Some(reply.missed(reason))
            }
        }
    }

    /// Reports an observation as missed at its deadline, so that the robot need not wait any longer.
    async fn miss(&mut self, reply: Option<PendingReply>, replies: &ReplySender) -> Result<()> {
        let Some(reply) = reply else { return Ok(()) };
        self.counts.missed += 1;
        replies.send(reply.missed(String::new())).await
    }

    fn opened(&self) -> SessionOutput {
        let identity = self.engine.identity();
        let (policy_id, task_id) = (identity.policy_id.clone(), identity.task_id.clone());
        let ranges = self.engine.shape().ranges.clone();
        let execution = self.engine.execution();
        SessionOutput::Opened { session_id: self.terms.id.clone(), policy_id, task_id, ranges, execution }
    }

    fn closed(&self, episode_id: Option<EpisodeId>) -> SessionOutput {
        let ObservationCounts { answered, dropped, missed, unscored: _ } = self.counts;
        SessionOutput::Closed { observations: answered, dropped, missed, episode_id }
    }

    /// Waits for the scores of all segments up to the last: a recording holds them all.
    async fn settle_scores(&mut self, memory: &mut Memory<M::History>) {
        let Some(watch) = memory.watch.as_mut().filter(|_| self.record.is_on()) else { return };
        if let (0, false, Some(given)) = (memory.unseen, memory.withheld, &memory.given) {
            watch.executed(given);
        }
        // A robot that closes waits for the last scores, but not for a stuck scorer.
        let _ = tokio::time::timeout(SCORED_WITHIN, watch.settle()).await;
        self.counts.unscored = Some(watch.left_out());
        self.record.scored(Some(watch));
    }

    /// Reads what has arrived, so that the newest observation is answered.
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
            Some(SessionInput::Open(_)) => Err(Error::invalid("open", "was sent twice; send observations, then close")),
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

    /// Queues an observation in place of one that still waits.
    fn see(&mut self, observation: Observation) -> Result<()> {
        let stamp_ns = observation.stamp_ns;
        let before = self.stamp_ns.replace(stamp_ns);
        if let Some(before) = before
            && stamp_ns < before
        {
            let fix = format!("is {stamp_ns}, before the previous {before}; stamps must not decrease");
            return Err(Error::invalid("observation.stamp_ns", fix));
        }
        self.record.observed(&observation, before)?;
        let dropped = self.waiting.put(observation, self.terms.settings.deadline);
        self.counts.dropped += u64::from(dropped);
        Ok(())
    }
}

#[cfg(test)]
mod tests;
