//! Sessions with a model that echoes its history.

use futures::channel::mpsc::{UnboundedSender, unbounded};

use super::{
    super::{
        live::Showing,
        reply_sender::Answers,
        testing::{Control, Parrot, SKIP, TestEngine, UNKNOWN, engine, engine_of_window, observation},
    },
    *,
};
use crate::error::Kind;

const IDLE: Duration = Duration::from_secs(30);
const DRAIN: Duration = Duration::from_secs(5);
/// Longer than an ungated model of a test takes.
const SOON: Duration = Duration::from_millis(20);

fn terms() -> Terms {
    Terms { id: SessionId::new(), settings: SessionSettings::default(), idle: IDLE, drain: DRAIN }
}

/// A robot's end of a session.
struct Robot {
    inputs: UnboundedSender<Result<SessionInput>>,
    answers: Answers,
}

impl Robot {
    /// Opens a session and waits for the `opened` output.
    async fn open(engine: &Arc<Engine<Parrot>>, stopping: &CancellationToken) -> Self {
        Self::open_under(terms(), engine, stopping).await
    }

    async fn open_under(terms: Terms, engine: &Arc<Engine<Parrot>>, stopping: &CancellationToken) -> Self {
        let (inputs, sent) = unbounded();
        let (replies, answers) = ReplySender::new(IDLE);
        let (session, stopping) =
            (Session::new(Arc::clone(engine), terms, Record::new(None, Showing::nowhere()), None), stopping.clone());
        tokio::spawn(async move {
            if let Err(error) = session.run(sent, &replies, &stopping).await {
                replies.fail(error);
            }
        });
        let mut robot = Self { inputs, answers };
        assert!(matches!(robot.answers.recv().await, Some(Ok(SessionOutput::Opened { .. }))));
        robot
    }

    fn sees(&self, number: u8, executed_action: &[f32]) {
        let input = SessionInput::Observation(observation(number, executed_action));
        self.inputs.unbounded_send(Ok(input)).unwrap();
    }

    /// The answered stamp, the action and the dropped count.
    async fn acts(&mut self) -> (i64, Vec<f32>, u64) {
        match self.answers.recv().await {
            Some(Ok(SessionOutput::Action { mut acted, dropped, score: None })) => {
                (acted.stamp_ns, acted.actions.pop().unwrap(), dropped)
            }
            other => panic!("{other:?}"),
        }
    }

    /// The missed stamp and the dropped count.
    async fn misses(&mut self) -> (i64, u64) {
        match self.answers.recv().await {
            Some(Ok(SessionOutput::Missed { stamp_ns, dropped, timings, reason })) => {
                assert!(timings.total_us > 0 && reason.is_empty());
                (stamp_ns, dropped)
            }
            other => panic!("{other:?}"),
        }
    }

    async fn fails(&mut self) -> Error {
        self.answers.recv().await.unwrap().unwrap_err()
    }

    /// Closes; returns the counts of answered, dropped and missed observations.
    async fn closes(&mut self) -> (u64, u64, u64) {
        self.inputs.unbounded_send(Ok(SessionInput::Close { outcome: Outcome::Unknown })).unwrap();
        match self.answers.recv().await {
            Some(Ok(SessionOutput::Closed { observations, dropped, missed, episode_id: None })) => {
                (observations, dropped, missed)
            }
            other => panic!("{other:?}"),
        }
    }
}

#[tokio::test]
async fn steps_that_the_robot_skipped_pass_unseen() {
    let (engine, control) = engine(8, 8).await;
    drop(control.gate);
    let mut robot = Robot::open(&engine, &CancellationToken::new()).await;
    robot.sees(1, &[]);
    assert_eq!(robot.acts().await, (1, vec![1.0, 0.0], 0));
    // The action before the fifth was not executed at the first.
    let skipping = Observation { skipped_steps: 3, ..observation(5, &[90.0, 0.0]) };
    robot.inputs.unbounded_send(Ok(SessionInput::Observation(skipping))).unwrap();
    assert_eq!(robot.acts().await, (5, vec![5.0, 1.0 + 3.0 * SKIP], 0), "none of them was dropped by the server");
    assert_eq!(robot.closes().await, (2, 0, 0));
}

#[tokio::test]
async fn the_newest_observation_is_answered_and_others_are_counted_as_dropped() {
    let (engine, mut control) = engine(8, 8).await;
    let mut robot = Robot::open(&engine, &CancellationToken::new()).await;
    robot.sees(1, &[]);
    assert_eq!(control.begun.recv().await, Some(1));
    for number in 2..=5 {
        robot.sees(number, &[100.0 * f32::from(number), 0.0]);
    }
    drop(control.gate);
    assert_eq!(robot.acts().await, (1, vec![1.0, 0.0], 0));
    assert_eq!(
        robot.acts().await,
        (5, vec![5.0, 200.0 + 3.0 * SKIP], 3),
        "dropped observations are counted and not in the history, but for the action after the first one"
    );
    assert_eq!(robot.closes().await, (2, 3, 0));
    assert!(robot.answers.recv().await.is_none());
}

#[tokio::test]
async fn the_sent_action_counts_as_executed_unless_the_robot_sends_another() {
    let (engine, control) = engine(8, 8).await;
    drop(control);
    let mut robot = Robot::open(&engine, &CancellationToken::new()).await;
    // Before the first observation no action can have been executed.
    robot.sees(1, &[50.0, 0.0]);
    assert_eq!(robot.acts().await.1, [1.0, 0.0]);
    robot.sees(2, &[]);
    assert_eq!(robot.acts().await.1, [2.0, 1.0]);
    robot.sees(3, &[10.0, 0.0]);
    assert_eq!(robot.acts().await.1, [3.0, 11.0]);
}

#[tokio::test]
async fn a_failed_session_does_not_affect_others() {
    let (engine, control) = engine(8, 8).await;
    drop(control);
    let stopping = CancellationToken::new();
    let mut good = Robot::open(&engine, &stopping).await;
    good.sees(1, &[]);
    good.acts().await;

    let mut bad = Robot::open(&engine, &stopping).await;
    let mut sent = observation(2, &[]);
    sent.proprioception = vec![f32::NAN];
    bad.inputs.unbounded_send(Ok(SessionInput::Observation(sent))).unwrap();
    let error = bad.fails().await;
    assert_eq!(error.kind(), Kind::Invalid);
    assert!(error.message().starts_with("observation.proprioception[0]: "), "{error}");
    let mut twice = Robot::open(&engine, &stopping).await;
    twice.inputs.unbounded_send(Ok(SessionInput::Open(SessionSettings::default()))).unwrap();
    assert!(twice.fails().await.message().starts_with("open: "));

    good.sees(3, &[]);
    assert_eq!(good.acts().await, (3, vec![3.0, 1.0], 0), "the other session keeps its history");
    drop(good.inputs);
    assert!(matches!(
        good.answers.recv().await,
        Some(Ok(SessionOutput::Closed { observations: 2, dropped: 0, missed: 0, episode_id: None }))
    ));
}

mod deadline;
mod ending;
