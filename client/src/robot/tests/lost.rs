//! Lost, stopping and unreachable servers.

use super::Done::{Command, Stop};
use super::*;

#[tokio::test(start_paused = true)]
async fn a_lost_server_causes_a_hold_then_a_stop_then_another_session() {
    let server = Server::new(|session, nth| match (session, nth) {
        (0, 2) => Reply::Break(Status::unavailable("gone")),
        _ => Reply::After(10, vec![f32::from(u8::try_from(session).unwrap())]),
    })
    .away(2);
    let mut robot = Noting::new(12);
    let report = run(&mut robot, &server, &plan()).await.unwrap();
    // Lost at 200; retried at 300, 500 and 900, when it is reachable.
    let expected = [(10, Command(0.0)), (110, Command(0.0)), (200, Command(0.0)), (300, Command(0.0)), (400, Stop)];
    assert_eq!(robot.done[..5], expected);
    assert_eq!(robot.done[5].1, Command(1.0));
    assert!((900..=1010).contains(&robot.done[5].0), "{:?}", robot.done);
    assert_eq!(robot.done.last(), Some(&(1200, Stop)));
    assert_eq!((report.reconnects, report.stops, report.held), (1, 1, 2));
    assert_eq!(report.policy_id, "pol_1");
    assert_eq!((report.ticks, server.sessions()), (12, 2));
}

#[tokio::test(start_paused = true)]
async fn chunks_bridge_a_loss_until_the_new_session_answers() {
    let server = Server::new(|session, nth| match (session, nth) {
        (0, 0) => Reply::After(10, vec![0.0, 1.0, 2.0, 3.0, 4.0, 5.0]),
        (0, _) => Reply::Break(Status::unavailable("gone")),
        _ => Reply::After(10, vec![9.0, 9.5]),
    });
    let mut robot = Noting::new(4);
    robot.slow = |nth| if nth == 1 { 30 } else { 0 };
    let report = run(&mut robot, &server, &plan()).await.unwrap();
    let commanded: Vec<Done> = robot.done.iter().map(|(_, done)| *done).collect();
    // Lost at 130 and open again at 230; from then on the chunks of the old session are ignored.
    assert_eq!(commanded, [Command(0.0), Command(1.0), Command(2.0), Command(9.0), Stop]);
    assert_eq!((report.held, report.reconnects), (0, 1));
}

#[tokio::test(start_paused = true)]
async fn a_silent_server_is_lost() {
    let server =
        Server::new(|session, nth| if session == 0 && nth > 0 { Reply::Hang } else { Reply::After(10, vec![1.0]) });
    let mut robot = Noting::new(25);
    let report = run(&mut robot, &server, &plan()).await.unwrap();
    // No response from 100 on, for two seconds.
    assert_eq!((server.sessions(), report.reconnects, report.stops), (2, 1, 1));
    let resumed = robot.done.iter().find(|(at, done)| *at > 500 && *done == Command(1.0)).unwrap();
    assert!((2200..2320).contains(&resumed.0), "{resumed:?}");
}

#[tokio::test(start_paused = true)]
async fn a_draining_server_is_left_for_another_session() {
    let server =
        Server::new(|session, nth| if (session, nth) == (0, 1) { Reply::Drain } else { Reply::After(10, vec![1.0]) });
    let mut robot = Noting::new(5);
    let report = run(&mut robot, &server, &plan()).await.unwrap();
    assert_eq!((report.drains, report.reconnects, report.stops), (1, 1, 0));
    assert_eq!(report.acted + report.held, 5);
}

#[tokio::test(start_paused = true)]
async fn a_rejection_ends_the_run_with_the_robot_stopped() {
    let server = Server::new(|_, nth| match nth {
        0 => Reply::After(10, vec![1.0]),
        _ => Reply::Break(Status::invalid_argument("observation.proprioception: 3 values, the task has 7")),
    });
    let mut robot = Noting::new(9);
    let error = run(&mut robot, &server, &plan()).await.unwrap_err();
    assert!(error.to_string().contains("the task has 7"), "{error}");
    assert!(matches!(error.cause, ControlCause::Client(_)) && error.not_stopped.is_none());
    assert_eq!((error.report.acted, server.sessions()), (1, 1));
    assert_eq!(robot.done, [(10, Command(1.0)), (100, Stop)]);
}

#[tokio::test(start_paused = true)]
async fn the_run_ends_when_the_server_stays_unreachable() {
    let server = Server::new(|_, nth| match nth {
        0 => Reply::After(10, vec![1.0]),
        _ => Reply::Break(Status::unavailable("gone")),
    })
    .away(1000);
    let plan = ControlPlan { give_up_after: Duration::from_secs(5), ..plan() };
    let mut robot = Noting::new(1000);
    let error = run(&mut robot, &server, &plan).await.unwrap_err();
    assert!(error.to_string().contains("unreachable"), "{error}");
    assert!((5000..7000).contains(&robot.begin.elapsed().as_millis()));
    // Stopped once, long before, and not again while it rests.
    assert_eq!((robot.stops(), robot.stopped_at_last()), (1, true));
}

#[tokio::test(start_paused = true)]
async fn silence_and_fullness_reported_by_the_server_are_retried() {
    for status in [Status::deadline_exceeded("silent"), Status::resource_exhausted("full")] {
        let server = Server::new(move |session, nth| match (session, nth) {
            (0, 1) => Reply::Break(status.clone()),
            _ => Reply::After(10, vec![1.0]),
        });
        let report = run(&mut Noting::new(5), &server, &plan()).await.unwrap();
        assert_eq!(report.reconnects, 1);
    }
}
