//! One robot's running episode: remembers its history, answers its newest observation, and counts what it passed
//! over. Holds nothing that another session could touch.

use std::{
    pin::pin,
    sync::Arc,
    time::{Duration, Instant},
};

use futures::{FutureExt as _, Stream, StreamExt as _, future::Fuse, future::FusedFuture as _};
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;

use super::{
    engine::{Answer, Engine},
    model::{Model, Step, Turn},
    observation,
};
use crate::{
    domain::{
        id::SessionId,
        observation::{Acted, Observation, SessionInput, SessionOutput, Timings},
    },
    error::{Error, Result},
};

/// Most observations looked at before the newest is answered, so that a flood cannot stop the answers.
const LOOK_AHEAD: usize = 256;

/// Where a session's answers go.
pub(super) type Outputs = mpsc::Sender<Result<SessionOutput>>;

/// What a session remembers from one observation to the next.
struct Memory<H> {
    history: Option<H>,
    /// What the policy gave last: taken as executed unless the robot says otherwise.
    given: Option<Vec<f32>>,
}

impl<H> Memory<H> {
    fn take(&mut self) -> Self {
        Self { history: self.history.take(), given: self.given.take() }
    }
}

/// An observation that waits.
struct Pending {
    observation: Observation,
    arrived: Instant,
    /// How many were passed over for it.
    dropped: u64,
}

/// A running session.
pub(super) struct Session<M: Model> {
    engine: Arc<Engine<M>>,
    pending: Option<Pending>,
    /// The robot has said its last.
    ended: bool,
    answered: u64,
    dropped: u64,
}

impl<M: Model> Session<M> {
    pub(super) fn new(engine: Arc<Engine<M>>) -> Self {
        Self { engine, pending: None, ended: false, answered: 0, dropped: 0 }
    }

    /// Serves the session until the robot closes it.
    ///
    /// # Errors
    /// Invalid for a bad observation; Cancelled when the robot is gone; Unavailable when the server stops.
    pub(super) async fn run(
        mut self,
        mut inputs: impl Stream<Item = Result<SessionInput>> + Unpin,
        outputs: &Outputs,
        stopping: &CancellationToken,
    ) -> Result<()> {
        let identity = self.engine.identity();
        let opened = SessionOutput::Opened {
            session_id: SessionId::new(),
            policy_id: identity.policy_id.clone(),
            task_id: identity.task_id.clone(),
        };
        send(outputs, opened).await?;
        let mut memory = Memory { history: None, given: None };
        let mut busy = pin!(Fuse::terminated());
        loop {
            if busy.is_terminated() {
                self.look_ahead(&mut inputs)?;
                if let Some(pending) = self.pending.take() {
                    busy.set(turn(Arc::clone(&self.engine), memory.take(), pending).fuse());
                } else if self.ended {
                    return send(
                        outputs,
                        SessionOutput::Closed { observations: self.answered, dropped: self.dropped, missed: 0 },
                    )
                    .await;
                }
            }
            tokio::select! {
                biased;
                () = outputs.closed() => return Err(gone()),
                () = stopping.cancelled() => {
                    return Err(Error::unavailable("the server is stopping; open the session again"));
                }
                turned = &mut busy, if !busy.is_terminated() => {
                    let (acted, dropped, remembered) = turned?;
                    memory = remembered;
                    self.answered += 1;
                    send(outputs, SessionOutput::Action { acted, dropped }).await?;
                }
                input = inputs.next(), if !self.ended => self.take(input)?,
            }
        }
    }

    /// Takes what has come already, so that the newest is answered.
    fn look_ahead(&mut self, inputs: &mut (impl Stream<Item = Result<SessionInput>> + Unpin)) -> Result<()> {
        for _ in 0..LOOK_AHEAD {
            if self.ended {
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
        match input.transpose()? {
            Some(SessionInput::Observation(observation)) => {
                let dropped = match self.pending.take() {
                    Some(passed) => {
                        self.dropped += 1;
                        passed.dropped + 1
                    }
                    None => 0,
                };
                self.pending = Some(Pending { observation, arrived: Instant::now(), dropped });
                Ok(())
            }
            Some(SessionInput::Open { .. }) => {
                Err(Error::invalid("open", "the session is open already; send observations, then close"))
            }
            Some(SessionInput::Close) | None => {
                self.ended = true;
                Ok(())
            }
        }
    }
}

async fn send(outputs: &Outputs, output: SessionOutput) -> Result<()> {
    outputs.send(Ok(output)).await.map_err(|_| gone())
}

fn gone() -> Error {
    Error::cancelled("the robot has gone")
}

/// Answers one observation on top of what is remembered.
async fn turn<M: Model>(
    engine: Arc<Engine<M>>,
    memory: Memory<M::History>,
    pending: Pending,
) -> Result<(Acted, u64, Memory<M::History>)> {
    let Pending { observation, arrived, dropped } = pending;
    let stamp_ns = observation.stamp_ns;
    let shape = engine.shape();
    let begun = Instant::now();
    let mut step = blocking(move || observation::step(&shape, "observation", &observation)).await?;
    let decode = begun.elapsed();
    // The first step of a history has nothing before it.
    step.executed = step.executed.or(memory.given).filter(|_| memory.history.is_some());
    let answer = engine.ask(Turn { history: memory.history, skipped: dropped, steps: vec![step] }).await?;
    let (history, acted) = acted(&engine, stamp_ns, answer, decode, arrived);
    let given = acted.actions.first().cloned();
    Ok((acted, dropped, Memory { history: Some(history), given }))
}

/// Answers the last of a window of observations that the caller keeps; `Act` is this.
///
/// # Errors
/// Invalid, naming the field; Exhausted when too many wait.
pub(super) async fn once<M: Model>(engine: &Engine<M>, observations: Vec<Observation>) -> Result<Acted> {
    let arrived = Instant::now();
    let Some(stamp_ns) = observations.last().map(|last| last.stamp_ns) else {
        return Err(Error::invalid("observations", "must hold at least the present one"));
    };
    let first = observations.len().saturating_sub(engine.window());
    let shape = engine.shape();
    let steps = blocking(move || {
        let recent = observations.iter().enumerate().skip(first);
        let mut steps: Vec<Step> = recent
            .map(|(index, observation)| observation::step(&shape, &format!("observations[{index}]"), observation))
            .collect::<Result<_>>()?;
        steps[0].executed = None;
        match steps.iter().skip(1).position(|step| step.executed.is_none()) {
            None => Ok(steps),
            Some(place) => Err(Error::invalid(
                &format!("observations[{}].executed_action", first + 1 + place),
                "must be set on every observation but the first: the server keeps no history for Act",
            )),
        }
    })
    .await?;
    let decode = arrived.elapsed();
    let answer = engine.try_ask(Turn { history: None, skipped: 0, steps }).await?;
    Ok(acted(engine, stamp_ns, answer, decode, arrived).1)
}

fn acted<M: Model>(
    engine: &Engine<M>,
    stamp_ns: i64,
    answer: Answer<M::History>,
    decode: Duration,
    arrived: Instant,
) -> (M::History, Acted) {
    let timings = Timings {
        decode_us: micros(decode),
        queue_us: micros(answer.queued),
        model_us: micros(answer.model),
        total_us: micros(arrived.elapsed()),
        ..Timings::default()
    };
    let policy_id = engine.identity().policy_id.clone();
    (answer.advanced.history, Acted { stamp_ns, actions: answer.advanced.actions, policy_id, timings })
}

fn micros(time: Duration) -> u64 {
    u64::try_from(time.as_micros()).unwrap_or(u64::MAX)
}

/// Decodes beside the runtime.
async fn blocking<T: Send + 'static>(work: impl FnOnce() -> Result<T> + Send + 'static) -> Result<T> {
    tokio::task::spawn_blocking(work).await.map_err(|error| Error::internal("decoding an observation", error))?
}

#[cfg(test)]
mod tests;
