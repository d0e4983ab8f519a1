//! Actions in time and late actions.

use super::Done::{Command, Stop};
use super::*;

#[tokio::test(start_paused = true)]
async fn answers_in_time_are_commanded() {
    let server = Server::new(|_, nth| Reply::After(20, vec![[1.0, 2.0, 3.0][nth]]));
    let mut robot = Noting::new(3);
    let report = run(&mut robot, &server, &plan()).await.unwrap();
    assert_eq!(robot.observed, [0, 100, 200]);
    assert_eq!(robot.done, [(20, Command(1.0)), (120, Command(2.0)), (220, Command(3.0)), (300, Stop)]);
    let expected = ControlReport { policy_id: "pol_0".into(), ticks: 3, acted: 3, ..ControlReport::default() };
    assert_eq!(report, expected);
    let opened = server.opened.lock().unwrap().clone();
    assert_eq!((opened[0].deployment.as_str(), opened[0].deadline_us), ("pick@prod", 100_000));
    assert_eq!(*server.closed.lock().unwrap(), 1);
}

#[tokio::test(start_paused = true)]
async fn a_late_action_makes_the_robot_hold_then_stop_then_resume() {
    let server = Server::new(|_, nth| match nth {
        0 | 5 => Reply::After(20, vec![7.0]),
        _ => Reply::Nothing,
    });
    let mut robot = Noting::new(7);
    let report = run(&mut robot, &server, &plan()).await.unwrap();
    let expected = [
        (20, Command(7.0)),
        // Other due actions are considered at three quarters of the period.
        (175, Command(7.0)),
        (275, Command(7.0)),
        (375, Stop),
        (520, Command(7.0)),
        (675, Command(7.0)),
        (700, Stop),
    ];
    assert_eq!(robot.done, expected);
    assert_eq!((report.ticks, report.acted, report.held), (7, 2, 3));
    assert_eq!((report.stops, report.rested), (1, 2));
}

#[tokio::test(start_paused = true)]
async fn a_robot_holds_in_its_own_way_and_reports_the_executed_action() {
    let server = Server::new(|_, nth| if nth == 0 { Reply::After(20, vec![7.0]) } else { Reply::Nothing });
    let mut robot = Noting::new(4);
    robot.hold = Some(-1.0);
    run(&mut robot, &server, &plan()).await.unwrap();
    let commands = [(20, Command(7.0)), (175, Command(-1.0)), (275, Command(-1.0)), (375, Stop)];
    assert_eq!(robot.done, commands);
    let executed: Vec<Vec<f32>> =
        server.seen.lock().unwrap().iter().map(|observation| observation.executed_action.clone()).collect();
    assert_eq!(executed, [vec![], vec![7.0], vec![-1.0], vec![-1.0]]);
}

#[tokio::test(start_paused = true)]
async fn no_command_is_sent_before_the_first_action() {
    let server = Server::new(|_, _| Reply::Nothing);
    let mut robot = Noting::new(8);
    let report = run(&mut robot, &server, &plan()).await.unwrap();
    assert_eq!(robot.done, [(800, Stop)]);
    assert_eq!((report.rested, report.stops), (8, 0));
}

#[tokio::test(start_paused = true)]
async fn late_chunks_are_ensembled_for_the_due_step() {
    // The answers to 0, 1 and 2 arrive at 140, 280 and 420 ms.
    let server =
        Server::new(|_, nth| Reply::After(140, [[0.0, 1.0, 2.0, 3.0], [10.0, 11.0, 12.0, 13.0]][nth % 2].to_vec()));
    let mut robot = Noting::new(4);
    let report = run(&mut robot, &server, &plan()).await.unwrap();
    let second = (-0.01_f64).exp();
    let both = (3.0 + second * 12.0) / (1.0 + second);
    let moments: Vec<u128> = robot.done.iter().map(|(at, _)| *at).collect();
    assert_eq!(moments, [175, 275, 375, 400]);
    let Command(third) = robot.done[2].1 else { panic!("{:?}", robot.done) };
    assert_eq!((robot.done[0].1, robot.done[1].1), (Command(1.0), Command(2.0)));
    assert!((f64::from(third) - both).abs() < 1e-6, "{third}, not {both}");
    assert_eq!((report.acted, report.rested, report.late), (3, 1, 0));
}

#[tokio::test(start_paused = true)]
async fn an_expired_answer_is_counted_and_not_commanded() {
    let server = Server::new(|_, nth| if nth == 0 { Reply::After(150, vec![7.0]) } else { Reply::Nothing });
    let mut robot = Noting::new(3);
    let report = run(&mut robot, &server, &plan()).await.unwrap();
    assert_eq!(robot.done, [(300, Stop)]);
    assert_eq!((report.late, report.rested), (1, 3));
}

#[tokio::test(start_paused = true)]
async fn a_missed_deadline_ends_the_wait() {
    let server = Server::new(|_, nth| if nth == 0 { Reply::After(20, vec![7.0]) } else { Reply::Missed });
    let mut robot = Noting::new(3);
    let report = run(&mut robot, &server, &plan()).await.unwrap();
    assert_eq!(robot.done, [(20, Command(7.0)), (100, Command(7.0)), (200, Command(7.0)), (300, Stop)]);
    assert_eq!((report.missed, report.held), (2, 2));
}
