//! The rate: delays on either side never move a tick.

use super::Done::{Command, Stop};
use super::*;

#[tokio::test(start_paused = true)]
async fn ticks_missed_by_a_slow_robot_are_skipped_and_counted() {
    let server = Server::new(|_, _| Reply::After(10, vec![1.0]));
    let mut robot = Noting::new(4);
    robot.slow = |nth| if nth == 1 { 250 } else { 0 };
    let report = run(&mut robot, &server, &plan()).await.unwrap();
    // Observing at 100 took until 350: the ticks at 200 and 300 are skipped and not caught up.
    assert_eq!(robot.observed, [0, 100, 400, 500]);
    assert_eq!((report.ticks, report.overruns), (4, 2));
    // The tick at 100 had no time left to wait for its answer, which was too late for the next.
    assert_eq!((report.acted, report.held, report.late), (3, 1, 1));
}

#[tokio::test(start_paused = true)]
async fn a_flood_of_observations_never_blocks_the_loop() {
    let server = Server::new(|_, nth| if nth == 0 { Reply::After(10, vec![1.0]) } else { Reply::Hang });
    let plan = ControlPlan { lost_after: Duration::from_secs(60), ..ControlPlan::new("pick@prod", 1000.0).unwrap() };
    let mut robot = Noting::new(1000);
    let report = run(&mut robot, &server, &plan).await.unwrap();
    assert_eq!((report.ticks, report.overruns), (1000, 0));
    let expected: Vec<u128> = (0..1000).collect();
    assert_eq!(robot.observed, expected);
    // The server took two; one waits in the channel and one as the latest: all others were replaced.
    assert_eq!((server.seen.lock().unwrap().len(), report.dropped), (2, 996));
}

#[tokio::test(start_paused = true)]
async fn a_slow_server_gets_the_newest_observation() {
    // Each takes more than three and a half periods.
    let server = Server::new(|_, _| Reply::After(360, vec![1.0; 12]));
    let mut robot = Noting::new(12);
    robot.stamp = |nth| (i64::try_from(nth).unwrap() + 1) * 100_000_000;
    let report = run(&mut robot, &server, &plan()).await.unwrap();
    let seen: Vec<i64> = server.seen.lock().unwrap().iter().map(|o| o.stamp_ns / 100_000_000).collect();
    // Whenever the server takes the one in the channel, the newest takes its place.
    assert_eq!(seen, [1, 2, 4, 8, 11]);
    // Replaced: 3, 5 to 7, 9 and 10; 12 still waited when the run ended.
    assert_eq!((report.dropped, report.late), (6, 0));
    assert_eq!((report.rested, report.acted), (3, 9));
}

#[tokio::test(start_paused = true)]
async fn the_run_ends_at_once_when_requested() {
    let server = Server::new(|_, _| Reply::After(10, vec![1.0]));
    let mut robot = Noting::new(1000);
    let until = sleep(Duration::from_millis(250));
    let report = control(&mut robot, server.clone(), &plan(), until).await.unwrap();
    assert_eq!(robot.done, [(10, Command(1.0)), (110, Command(1.0)), (210, Command(1.0)), (250, Stop)]);
    assert_eq!((report.acted, *server.closed.lock().unwrap()), (3, 1));
}
