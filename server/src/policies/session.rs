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
                    return send(outputs, SessionOutput::Closed { observations: self.answered, dropped: self.dropped })
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
    let answer = engine.ask(Turn { history: memory.history, steps: vec![step] }).await?;
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
    let answer = engine.try_ask(Turn { history: None, steps }).await?;
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
mod tests {
    #![allow(clippy::unwrap_used, clippy::panic)]
    use futures::channel::mpsc::{UnboundedSender, unbounded};

    use super::{
        super::testing::{Parrot, engine, observation},
        *,
    };
    use crate::error::Kind;

    /// A robot's end of a session.
    struct Robot {
        says: UnboundedSender<Result<SessionInput>>,
        hears: mpsc::Receiver<Result<SessionOutput>>,
    }

    impl Robot {
        /// Opens a session and hears that it is open.
        async fn open(engine: &Arc<Engine<Parrot>>, stopping: &CancellationToken) -> Self {
            let (says, inputs) = unbounded();
            let (outputs, hears) = mpsc::channel(16);
            let (session, stopping) = (Session::new(Arc::clone(engine)), stopping.clone());
            tokio::spawn(async move {
                if let Err(error) = session.run(inputs, &outputs, &stopping).await {
                    let _ = outputs.send(Err(error)).await;
                }
            });
            let mut robot = Self { says, hears };
            assert!(matches!(robot.hears.recv().await, Some(Ok(SessionOutput::Opened { .. }))));
            robot
        }

        fn sees(&self, number: u8, executed_action: &[f32]) {
            let input = SessionInput::Observation(observation(number, executed_action));
            self.says.unbounded_send(Ok(input)).unwrap();
        }

        /// The stamp answered, the action and the dropped count.
        async fn acts(&mut self) -> (i64, Vec<f32>, u64) {
            match self.hears.recv().await {
                Some(Ok(SessionOutput::Action { mut acted, dropped })) => {
                    (acted.stamp_ns, acted.actions.pop().unwrap(), dropped)
                }
                other => panic!("{other:?}"),
            }
        }

        async fn fails(&mut self) -> Error {
            self.hears.recv().await.unwrap().unwrap_err()
        }

        /// Closes and gives what was answered and what was dropped.
        async fn closes(&mut self) -> (u64, u64) {
            self.says.unbounded_send(Ok(SessionInput::Close)).unwrap();
            match self.hears.recv().await {
                Some(Ok(SessionOutput::Closed { observations, dropped })) => (observations, dropped),
                other => panic!("{other:?}"),
            }
        }
    }

    #[tokio::test]
    async fn the_newest_observation_wins_and_the_others_are_counted() {
        let (engine, mut control) = engine(8, 8).await;
        let mut robot = Robot::open(&engine, &CancellationToken::new()).await;
        robot.sees(1, &[]);
        assert_eq!(control.begun.recv().await, Some(1));
        for number in 2..=5 {
            robot.sees(number, &[100.0, 0.0]);
        }
        drop(control.gate);
        assert_eq!(robot.acts().await, (1, vec![1.0, 0.0], 0));
        assert_eq!(robot.acts().await, (5, vec![5.0, 100.0], 3), "what was dropped is not remembered");
        assert_eq!(robot.closes().await, (2, 3));
        assert!(robot.hears.recv().await.is_none());
    }

    #[tokio::test]
    async fn the_given_action_counts_as_executed_unless_the_robot_says_otherwise() {
        let (engine, control) = engine(8, 8).await;
        drop(control);
        let mut robot = Robot::open(&engine, &CancellationToken::new()).await;
        // Before the first observation nothing can have been executed.
        robot.sees(1, &[50.0, 0.0]);
        assert_eq!(robot.acts().await.1, [1.0, 0.0]);
        robot.sees(2, &[]);
        assert_eq!(robot.acts().await.1, [2.0, 1.0]);
        robot.sees(3, &[10.0, 0.0]);
        assert_eq!(robot.acts().await.1, [3.0, 11.0]);
    }

    #[tokio::test]
    async fn a_bad_session_ends_alone() {
        let (engine, control) = engine(8, 8).await;
        drop(control);
        let stopping = CancellationToken::new();
        let mut good = Robot::open(&engine, &stopping).await;
        good.sees(1, &[]);
        good.acts().await;

        let mut bad = Robot::open(&engine, &stopping).await;
        let mut sent = observation(2, &[]);
        sent.proprioception = vec![f32::NAN];
        bad.says.unbounded_send(Ok(SessionInput::Observation(sent))).unwrap();
        let error = bad.fails().await;
        assert_eq!(error.kind(), Kind::Invalid);
        assert!(error.message().starts_with("observation.proprioception[0]: "), "{error}");
        let mut twice = Robot::open(&engine, &stopping).await;
        let open = SessionInput::Open { deployment: "again".into(), control_rate_hz: 0.0 };
        twice.says.unbounded_send(Ok(open)).unwrap();
        assert!(twice.fails().await.message().starts_with("open: "));

        good.sees(3, &[]);
        assert_eq!(good.acts().await, (3, vec![3.0, 1.0], 0), "the other session goes on with its history");
        drop(good.says);
        assert!(matches!(good.hears.recv().await, Some(Ok(SessionOutput::Closed { observations: 2, dropped: 0 }))));
    }

    #[tokio::test]
    async fn a_stop_ends_sessions() {
        let (engine, _control) = engine(8, 8).await;
        let stopping = CancellationToken::new();
        let mut robot = Robot::open(&engine, &stopping).await;
        stopping.cancel();
        assert_eq!(robot.fails().await.kind(), Kind::Unavailable);
    }

    #[tokio::test]
    async fn act_takes_the_window_that_the_caller_keeps() {
        let (engine, control) = engine(8, 8).await;
        drop(control);
        let seen = [observation(1, &[]), observation(2, &[]), observation(3, &[7.0, 0.0]), observation(4, &[5.0, 0.0])];
        let acted = once(&engine, seen.to_vec()).await.unwrap();
        assert_eq!((acted.stamp_ns, acted.actions), (4, vec![vec![4.0, 12.0]]), "the window is the last three");

        let error = once(&engine, Vec::new()).await.unwrap_err();
        assert!(error.message().starts_with("observations: "), "{error}");
        let error = once(&engine, vec![observation(1, &[]), observation(2, &[])]).await.unwrap_err();
        assert!(error.message().starts_with("observations[1].executed_action: "), "{error}");
    }
}
