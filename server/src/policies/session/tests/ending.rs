//! Ends of sessions that their robots do not close.

use super::*;

#[tokio::test]
async fn decreasing_stamps_end_the_session() {
    let (engine, control) = engine(8, 8).await;
    drop(control);
    let mut robot = Robot::open(&engine, &CancellationToken::new()).await;
    for number in [5, 5] {
        robot.sees(number, &[]);
        assert_eq!(robot.acts().await.0, i64::from(number), "an equal stamp is allowed");
    }
    robot.sees(4, &[]);
    let error = robot.fails().await;
    assert_eq!(error.kind(), Kind::Invalid);
    assert!(error.message().starts_with("observation.stamp_ns: is 4, before the previous 5; "), "{error}");
}

#[tokio::test(start_paused = true)]
async fn a_silent_robot_loses_its_session() {
    let (engine, _control) = engine(8, 8).await;
    let begun = Instant::now();
    let mut robot = Robot::open(&engine, &CancellationToken::new()).await;
    let error = robot.fails().await;
    assert_eq!(error.kind(), Kind::Late, "{error}");
    assert!(begun.elapsed() >= IDLE);
    assert!(robot.answers.recv().await.is_none());
}

#[tokio::test(start_paused = true)]
async fn a_robot_with_a_pending_reply_is_not_silent() {
    let (engine, mut control) = engine(8, 8).await;
    let mut robot = Robot::open(&engine, &CancellationToken::new()).await;
    robot.sees(1, &[]);
    assert_eq!(control.begun.recv().await, Some(1));
    tokio::time::sleep(2 * IDLE).await;
    drop(control.gate);
    assert_eq!(robot.acts().await.0, 1);
    assert_eq!(robot.fails().await.kind(), Kind::Late, "silent after the answer");
}

#[tokio::test(start_paused = true)]
async fn a_robot_that_reads_no_output_loses_its_session() {
    let (engine, control) = engine(8, 8).await;
    drop(control);
    let mut robot = Robot::open(&engine, &CancellationToken::new()).await;
    // Each is answered with a `missed` of its own.
    for number in 0..40 {
        let mut late = observation(number, &[]);
        late.deadline = Some(Duration::ZERO);
        robot.inputs.unbounded_send(Ok(SessionInput::Observation(late))).unwrap();
        tokio::time::sleep(SOON).await;
    }
    while !robot.inputs.is_closed() {
        tokio::time::sleep(SOON).await;
    }
    let mut missed = 0;
    let error = loop {
        match robot.answers.recv().await.unwrap() {
            Ok(SessionOutput::Missed { .. }) => missed += 1,
            Ok(other) => panic!("{other:?}"),
            Err(error) => break error,
        }
    };
    assert_eq!(error.kind(), Kind::Late);
    assert!(error.message().contains("not read"), "{error}");
    assert!(missed <= 17, "{missed}");
}

#[tokio::test]
async fn a_stop_drains_sessions_and_ends_them_at_the_announced_time() {
    let (engine, control) = engine(8, 8).await;
    drop(control);
    let stopping = CancellationToken::new();
    let mut continues = Robot::open(&engine, &stopping).await;
    let mut closes = Robot::open(&engine, &stopping).await;
    let stopped_at = Millis::now();
    stopping.cancel();
    let begun = Instant::now();
    for robot in [&mut continues, &mut closes] {
        let output = robot.answers.recv().await.unwrap().unwrap();
        let SessionOutput::Draining { close_at } = output else { panic!("{output:?}") };
        assert!(close_at >= stopped_at.after(DRAIN) && close_at <= Millis::now().after(DRAIN));
    }
    continues.sees(1, &[]);
    assert_eq!(continues.acts().await.0, 1, "it continues until then");
    assert_eq!(closes.closes().await, (0, 0, 0));
    // From here on, the test waits for time only.
    tokio::time::pause();
    assert_eq!(continues.fails().await.kind(), Kind::Unavailable);
    assert!(begun.elapsed() >= DRAIN && begun.elapsed() < IDLE);
}
