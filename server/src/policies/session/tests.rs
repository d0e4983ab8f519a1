//! Sessions against a model that remembers what it was told.

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
