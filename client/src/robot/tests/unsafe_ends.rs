//! Ends that would be unsafe: the robot is stopped at the end of every run.

use super::Done::{Command, Stop};
use super::*;

fn answering() -> Server {
    Server::new(|_, _| Reply::After(10, vec![1.0]))
}

#[tokio::test(start_paused = true)]
async fn a_failing_robot_is_stopped() {
    for (fails, acted) in [
        ((|what, nth| what == "observe" && nth == 1) as fn(&str, usize) -> bool, 1),
        (|what, nth| what == "command" && nth == 1, 1),
        (|what, nth| what == "command" && nth == 0, 0),
    ] {
        let mut robot = Noting::new(9);
        robot.fails = fails;
        let error = run(&mut robot, &answering(), &plan()).await.unwrap_err();
        assert!(matches!(error.cause, ControlCause::Robot(_)), "{error}");
        assert_eq!((error.report.acted, robot.stops()), (acted, 1));
        assert!(robot.stopped_at_last() && error.not_stopped.is_none());
    }
}

#[tokio::test(start_paused = true)]
async fn a_robot_that_cannot_be_stopped_is_reported() {
    let mut robot = Noting::new(9);
    robot.fails = |what, nth| what == "stop" || (what == "observe" && nth == 1);
    let error = run(&mut robot, &answering(), &plan()).await.unwrap_err();
    assert_eq!(error.to_string(), "robot: observe failed; and the robot could not be stopped: stop failed");
    let mut robot = Noting::new(1);
    robot.fails = |what, _| what == "stop";
    let error = run(&mut robot, &answering(), &plan()).await.unwrap_err();
    assert_eq!(error.to_string(), "the robot could not be stopped: stop failed");
}

#[tokio::test(start_paused = true)]
async fn a_dropped_run_stops_the_robot_and_closes_the_session() {
    let (server, mut robot) = (answering(), Noting::new(1000));
    let dropped = tokio::time::timeout(Duration::from_millis(150), run(&mut robot, &server, &plan())).await;
    assert!(dropped.is_err());
    assert_eq!(robot.done, [(10, Command(1.0)), (110, Command(1.0)), (150, Stop)]);
    sleep(Duration::from_millis(1)).await;
    assert_eq!(*server.closed.lock().unwrap(), 1);
}

#[tokio::test(start_paused = true)]
async fn stamps_that_do_not_rise_end_the_run() {
    let mut robot = Noting::new(9);
    robot.stamp = |nth| [5, 6, 6][nth];
    let error = run(&mut robot, &answering(), &plan()).await.unwrap_err();
    assert!(error.to_string().starts_with("observation.stamp_ns: 6 is not after 6"), "{error}");
    assert!(robot.stopped_at_last());
}

#[tokio::test(start_paused = true)]
async fn non_finite_actions_move_nothing() {
    let server = Server::new(|_, nth| Reply::After(10, vec![[1.0, f32::NAN][nth]]));
    let mut robot = Noting::new(9);
    let error = run(&mut robot, &server, &plan()).await.unwrap_err();
    assert!(error.to_string().contains("not finite"), "{error}");
    assert_eq!(robot.done, [(10, Command(1.0)), (110, Stop)]);
}

#[tokio::test(start_paused = true)]
async fn an_invalid_plan_is_rejected_before_any_motion() {
    let server = answering();
    let mut robot = Noting::new(9);
    let plan = ControlPlan { answer_within: Duration::from_secs(1), ..plan() };
    assert!(run(&mut robot, &server, &plan).await.unwrap_err().to_string().starts_with("answer_within"));
    assert_eq!((robot.done, server.sessions()), (vec![(0, Stop)], 0));
}
