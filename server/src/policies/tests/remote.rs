//! Deployments and sessions with a policy that another server runs, and with one that does not answer.

use std::{
    net::SocketAddr,
    sync::atomic::{AtomicUsize, Ordering::SeqCst},
};

use futures::{SinkExt as _, StreamExt as _};
use tokio::{
    net::{TcpListener, TcpSocket},
    task::JoinHandle,
};
use tokio_tungstenite::{accept_async, tungstenite::Message};

use super::*;
use crate::domain::remote::{Protocol, RemotePolicy};

/// A server of openpi. Its chunk of four counts up from the first value of the proprioception.
struct Server {
    address: String,
    calls: Arc<AtomicUsize>,
    accepting: JoinHandle<()>,
    /// Keeps the port from other programs, also while no server listens on it.
    port: TcpSocket,
}

impl Server {
    fn start(lab: &Lab) -> Self {
        Self::on(lab, SocketAddr::from(([127, 0, 0, 1], 0)))
    }

    /// On the address of one that has ended.
    fn again(lab: &Lab, ended: &Self) -> Self {
        Self::on(lab, ended.port.local_addr().unwrap())
    }

    fn on(lab: &Lab, address: SocketAddr) -> Self {
        let port = bound(address);
        let listener: TcpListener = bound(port.local_addr().unwrap()).listen(16).unwrap();
        let address = format!("ws://{}", listener.local_addr().unwrap());
        let calls: Arc<AtomicUsize> = Arc::default();
        let (spec, counted) = (lab.task.spec.clone(), Arc::clone(&calls));
        let accepting = tokio::spawn(async move {
            // Its connections end with it.
            let mut connections = tokio::task::JoinSet::new();
            while let Ok((stream, _)) = listener.accept().await {
                let (spec, calls) = (spec.clone(), Arc::clone(&counted));
                connections.spawn(async move {
                    let Ok(mut socket) = accept_async(stream).await else { return };
                    let metadata = gleaner_openpi::Metadata { deployment: "x", policy_id: "y", task: &spec };
                    socket.send(Message::binary(gleaner_openpi::metadata(&metadata))).await.unwrap();
                    while let Some(Ok(Message::Binary(message))) = socket.next().await {
                        calls.fetch_add(1, SeqCst);
                        let first = gleaner_openpi::request(&message, &spec).unwrap().proprioception[0];
                        let actions: Vec<_> = (0..4_u8).map(|at| vec![first + f32::from(at)]).collect();
                        let reply = gleaner_openpi::Reply {
                            actions: &actions,
                            infer_ms: 1.0,
                            policy_ms: 1.0,
                            previous_ms: None,
                            score: None,
                        };
                        // The client may be gone.
                        let _ = socket.send(Message::binary(gleaner_openpi::reply(&reply))).await;
                    }
                });
            }
        });
        Self { address, calls, accepting, port }
    }

    /// Ends it and waits until its port is free for another one.
    async fn stop(&mut self) {
        self.accepting.abort();
        assert!((&mut self.accepting).await.unwrap_err().is_cancelled());
    }
}

/// A socket on this address, which others may have too unless they listen.
fn bound(address: SocketAddr) -> TcpSocket {
    let socket = TcpSocket::new_v4().unwrap();
    socket.set_reuseaddr(true).unwrap();
    socket.bind(address).unwrap();
    socket
}

fn record(address: &str) -> RemotePolicy {
    RemotePolicy {
        protocol: Protocol::Openpi,
        address: address.into(),
        model: String::new(),
        model_version: String::new(),
        inputs: Vec::new(),
        output: String::new(),
        chunk_length: 4,
        execute_length: 2,
        sequences: false,
        answer_within_ms: 5000,
        source: "a lab".into(),
    }
}

/// The task has no cameras.
fn seen(number: u8, executed_action: &[f32]) -> Observation {
    Observation { cameras: Vec::new(), ..observation(number, executed_action) }
}

/// A lab with a server and its deployment `arm`.
async fn deployed() -> (Lab, Server, Policies, PolicyId) {
    let lab = Lab::new().await;
    let server = Server::start(&lab);
    let policies = lab.policies();
    let policy = policies.register(&lab.task, record(&server.address)).await.unwrap().id;
    policies.deploy("arm", Assignment::of(&policy)).await.unwrap();
    (lab, server, policies, policy)
}

#[tokio::test]
async fn a_session_acts_by_the_other_server_and_executes_its_chunks() {
    let (_lab, server, policies, policy) = deployed().await;
    assert_eq!(server.calls.load(SeqCst), 1, "the blank observation of the deployment");
    let mut robot = Robot::new(&policies);
    robot.opens("arm");
    let opened = robot.receives().await.unwrap();
    let SessionOutput::Opened { policy_id, execution, .. } = opened else { panic!("{opened:?}") };
    assert_eq!((policy_id, execution.horizon()), (policy.clone(), 2));
    let first = robot.acts(seen(10, &[])).await;
    assert_eq!((first.policy_id, first.actions.len(), first.actions[0][0]), (policy, 4, 10.0));
    let second = robot.acts(seen(20, &[])).await;
    assert_eq!(second.actions, [[11.0], [12.0], [13.0]], "the rest of the chunk");
    assert_eq!(server.calls.load(SeqCst), 2);
    assert_eq!(robot.acts(seen(30, &[])).await.actions[0][0], 30.0);
    assert_eq!(server.calls.load(SeqCst), 3);
    let single = policies.act("arm", vec![seen(40, &[])]).await.unwrap();
    assert_eq!(single.actions[0][0], 40.0);
    robot.sends(SessionInput::Close { outcome: Outcome::Unknown });
    assert!(matches!(robot.receives().await, Ok(SessionOutput::Closed { observations: 3, missed: 0, .. })));
}

/// As those of openpi, whose robots execute as many actions of an answer as they like.
#[tokio::test]
async fn a_session_of_new_chunks_gets_one_for_each_observation() {
    let (_lab, server, policies, _) = deployed().await;
    let mut robot = Robot::new(&policies);
    let settings = SessionSettings { deployment: "arm".into(), new_chunks: true, ..SessionSettings::default() };
    robot.sends(SessionInput::Open(settings));
    robot.receives().await.unwrap();
    for (call, number) in [(2, 10), (3, 20), (4, 30)] {
        let acted = robot.acts(seen(number, &[])).await;
        assert_eq!((acted.actions.len(), acted.actions[0][0]), (4, f32::from(number)));
        assert_eq!(server.calls.load(SeqCst), call);
    }
}

#[tokio::test]
async fn a_robot_with_deadlines_misses_them_while_the_server_is_gone_and_then_acts_again() {
    let (lab, mut server, policies, _) = deployed().await;
    let mut robot = Robot::new(&policies);
    robot.opens("arm");
    robot.receives().await.unwrap();
    let timed = |number: u8| Observation { deadline: Some(Duration::from_secs(30)), ..seen(number, &[]) };
    robot.acts(timed(1)).await;
    robot.acts(timed(2)).await;
    server.stop().await;
    let begun = std::time::Instant::now();
    for number in 3..6 {
        robot.sends(SessionInput::Observation(timed(number)));
        let output = robot.receives().await.unwrap();
        let SessionOutput::Missed { reason, .. } = output else { panic!("{output:?}") };
        assert!(reason.contains(&server.address) && reason.contains("start it"), "{reason}");
    }
    assert!(begun.elapsed() < Duration::from_secs(20), "a robot does not wait for its deadline");
    let _back = Server::again(&lab, &server);
    let mut attempts = tokio::time::interval(Duration::from_millis(20));
    for number in 6.. {
        attempts.tick().await;
        robot.sends(SessionInput::Observation(timed(number)));
        match robot.receives().await.unwrap() {
            SessionOutput::Action { acted, .. } => {
                assert_eq!(acted.actions[0][0], f32::from(number));
                break;
            }
            SessionOutput::Missed { .. } => {}
            other @ (SessionOutput::Opened { .. } | SessionOutput::Draining { .. } | SessionOutput::Closed { .. }) => {
                panic!("{other:?}")
            }
        }
    }
}

#[tokio::test]
async fn a_session_without_a_deadline_ends_when_the_server_is_gone() {
    let (_lab, mut server, policies, _) = deployed().await;
    server.stop().await;
    // It opens, because its server may be back by the first observation.
    let mut robot = Robot::new(&policies);
    robot.opens("arm");
    robot.receives().await.unwrap();
    robot.sends(SessionInput::Observation(seen(1, &[])));
    let error = robot.receives().await.unwrap_err();
    assert_eq!(error.kind(), Kind::Unavailable);
    assert!(error.message().contains(&server.address), "{error}");
    assert_eq!(policies.act("arm", vec![seen(1, &[])]).await.unwrap_err().kind(), Kind::Unavailable);
}

#[tokio::test]
async fn only_a_server_that_answers_is_deployed() {
    let lab = Lab::new().await;
    let policies = lab.policies();
    let mut server = Server::start(&lab);
    let gone = policies.register(&lab.task, record(&server.address)).await.unwrap().id;
    server.stop().await;
    let error = policies.deploy("arm", Assignment::of(&gone)).await.unwrap_err();
    assert_eq!(error.kind(), Kind::Unavailable);
    assert!(error.message().contains(&server.address), "{error}");
    assert_eq!(lab.store.deployment("arm").await.unwrap_err().kind(), Kind::NotFound);

    let server = Server::start(&lab);
    let other = RemotePolicy { output: "action".into(), ..record(&server.address) };
    let other = policies.register(&lab.task, other).await.unwrap().id;
    let error = policies.deploy("arm", Assignment::of(&other)).await.unwrap_err();
    assert_eq!(error.kind(), Kind::Precondition);
    assert!(error.message().contains("action: is missing in its answer"), "{error}");
    let hidden = Assignment { hide_history: true, ..Assignment::of(&other) };
    assert!(policies.deploy("arm", hidden).await.unwrap_err().message().starts_with("hide_history: "));
}

#[tokio::test]
async fn a_policy_of_a_host_that_is_not_allowed_is_not_registered() {
    let lab = Lab::new().await;
    let policies = lab.policies();
    let error = policies.register(&lab.task, record("ws://10.0.0.5:8000")).await.unwrap_err();
    assert_eq!(error.kind(), Kind::Precondition);
    assert!(error.message().contains("--policy-servers 10.0.0.5:8000"), "{error}");
    for (wrong, field) in [
        (record("http://127.0.0.1:8000"), "remote.address: "),
        (RemotePolicy { execute_length: 5, ..record("ws://127.0.0.1:8000") }, "remote.execute_length: "),
    ] {
        assert!(policies.register(&lab.task, wrong).await.unwrap_err().message().starts_with(field), "{field}");
    }
    assert!(lab.store.policies(&lab.task.id).await.unwrap().is_empty());
}
