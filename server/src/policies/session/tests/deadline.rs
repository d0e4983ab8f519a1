//! Deadlines: late actions are never sent, and the history accounts for unseen steps.

use super::{super::super::model::Begin, *};

/// A deadline that a held model misses, and within which it begins on a busy machine too.
const HURRIED: Duration = Duration::from_secs(1);

fn hurried() -> Terms {
    let settings = SessionSettings { deadline: Some(HURRIED), ..SessionSettings::default() };
    Terms { settings, ..terms() }
}

/// The first answer misses its deadline. The second observation has a later deadline of its own, and the action that was
/// `executed` since the first one; `acts` is its answer.
async fn expect_second((engine, mut control): (Arc<TestEngine>, Control), executed: &[f32], acts: [f32; 2]) {
    let mut robot = Robot::open_under(hurried(), &engine, &CancellationToken::new()).await;
    robot.sees(1, &[]);
    assert_eq!(control.begun.recv().await, Some(1));
    assert_eq!(robot.misses().await, (1, 0), "while the model still runs");
    control.gate.send(()).unwrap();
    drop(control.gate);
    let mut patient = observation(2, executed);
    patient.deadline = Some(IDLE);
    robot.inputs.unbounded_send(Ok(SessionInput::Observation(patient))).unwrap();
    assert_eq!(robot.acts().await, (2, acts.to_vec(), 0));
    assert_eq!(robot.closes().await, (1, 0, 1));
}

#[tokio::test]
async fn a_late_answer_is_reported_missed_at_its_deadline_and_kept_in_the_history() {
    expect_second(engine(8, 8).await, &[7.0, 0.0], [2.0, 7.0]).await;
}

/// The robot has commanded nothing yet, so no action is known that was executed after the first observation.
#[tokio::test]
async fn a_late_first_answer_does_not_end_the_session() {
    expect_second(engine(8, 8).await, &[], [2.0, 0.0]).await;
}

/// Otherwise a policy that is slower than the deadline would predict its first chunk again and again, and never act.
#[tokio::test]
async fn a_late_first_answer_of_a_policy_without_history_is_kept() {
    expect_second(engine_of_window(1, 8, 8).await, &[], [2.0, UNKNOWN]).await;
}

#[tokio::test]
async fn an_observation_whose_deadline_passes_in_the_queue_is_not_run() {
    let (engine, mut control) = engine(8, 8).await;
    let mut robot = Robot::open(&engine, &CancellationToken::new()).await;
    robot.sees(1, &[]);
    assert_eq!(control.begun.recv().await, Some(1));
    robot.sees(2, &[]);
    let mut late = observation(3, &[90.0, 0.0]);
    late.deadline = Some(SOON);
    robot.inputs.unbounded_send(Ok(SessionInput::Observation(late))).unwrap();
    assert_eq!(robot.misses().await, (3, 1), "the replaced observation was dropped");
    drop(control.gate);
    assert_eq!(robot.acts().await, (1, vec![1.0, 0.0], 0));
    robot.sees(4, &[]);
    assert_eq!(robot.acts().await, (4, vec![4.0, 1.0 + 2.0 * SKIP], 0), "two steps passed unseen");
    assert_eq!(robot.closes().await, (2, 1, 1));
    assert_eq!((control.begun.recv().await, control.begun.try_recv().ok()), (Some(1), None));
}

#[tokio::test]
async fn a_session_without_a_deadline_waits_for_its_answer() {
    let (engine, mut control) = engine(8, 8).await;
    let mut robot = Robot::open(&engine, &CancellationToken::new()).await;
    robot.sees(1, &[]);
    assert_eq!(control.begun.recv().await, Some(1));
    assert!(tokio::time::timeout(2 * SOON, robot.answers.recv()).await.is_err());
    drop(control.gate);
    assert_eq!(robot.acts().await.0, 1);
}

#[tokio::test]
async fn an_unsent_action_is_not_taken_as_executed() {
    let (engine, mut control) = engine(8, 8).await;
    let mut robot = Robot::open(&engine, &CancellationToken::new()).await;
    control.gate.send(()).unwrap();
    robot.sees(1, &[]);
    assert_eq!(robot.acts().await.0, 1);
    assert_eq!(control.begun.recv().await, Some(1));
    let mut late = observation(5, &[]);
    late.deadline = Some(HURRIED);
    robot.inputs.unbounded_send(Ok(SessionInput::Observation(late))).unwrap();
    assert_eq!(robot.misses().await, (5, 0));
    drop(control.gate);
    robot.sees(6, &[]);
    assert_eq!(robot.acts().await.1, [6.0, 2.0], "twice the first action, which the robot still holds");
}

#[tokio::test]
async fn after_an_unsent_answer_the_executed_action_is_unknown() {
    let (engine, _control) = engine(8, 8).await;
    let mut session = Session::new(engine, terms(), Record::new(None, Showing::nowhere()), None);
    let (mut memory, actions) = (Memory::new(Begin::default(), None), || StepAnswer::Acted(vec![vec![1.0, 0.0]]));
    for (owed, withheld) in [(true, false), (false, true), (true, false)] {
        session.in_flight = owed.then(|| PendingReply::for_observation(&observation(1, &[]), None, 0));
        assert_eq!(session.settle(actions(), &mut memory).is_some(), owed);
        assert_eq!(memory.withheld, withheld);
    }
    session.in_flight = Some(PendingReply::for_observation(&observation(1, &[]), Some(Duration::ZERO), 0));
    assert!(matches!(session.settle(actions(), &mut memory), Some(SessionOutput::Missed { .. })));
    assert!(memory.withheld);
}
