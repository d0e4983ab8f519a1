//! Real connections to the address for clients of openpi. The policy is that of another server.

use std::net::SocketAddr;

use clap::Parser as _;
use futures::SinkExt as _;
use gleaner_openpi::Value;
use tokio::{net::TcpStream, task::JoinSet};
use tokio_tungstenite::{
    WebSocketStream, accept_async, client_async,
    tungstenite::{self, Message},
};

use super::*;
use crate::{
    config::{Cli, Command},
    domain::{
        id::SessionId,
        policy::Assignment,
        remote::{Protocol, RemotePolicy},
        task::Task,
        time::Millis,
    },
    store::testing,
};

const DEPLOYMENT: &str = "arm@prod";
/// Far more than any event takes on a busy machine.
const BOUND: Duration = Duration::from_mins(2);

/// A server of openpi with one action for every observation.
async fn policy_server(task: &Task) -> (RemotePolicy, AbortOnDropHandle<()>) {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let policy = RemotePolicy {
        protocol: Protocol::Openpi,
        address: format!("ws://{}", listener.local_addr().unwrap()),
        model: String::new(),
        model_version: String::new(),
        inputs: Vec::new(),
        output: String::new(),
        chunk_length: 1,
        execute_length: 1,
        sequences: false,
        answer_within_ms: 60_000,
        source: String::new(),
    };
    let spec = task.spec.clone();
    let serving = tokio::spawn(async move {
        let mut connections = JoinSet::new();
        while let Ok((stream, _)) = listener.accept().await {
            let metadata = gleaner_openpi::Metadata { deployment: "x", policy_id: "y", task: &spec };
            let metadata = gleaner_openpi::metadata(&metadata);
            connections.spawn(async move {
                let mut socket = accept_async(stream).await.unwrap();
                socket.send(Message::binary(metadata)).await.unwrap();
                while let Some(Ok(Message::Binary(_))) = socket.next().await {
                    let reply = gleaner_openpi::Reply {
                        actions: &[vec![0.5]],
                        infer_ms: 1.0,
                        policy_ms: 1.0,
                        previous_ms: None,
                        score: None,
                    };
                    socket.send(Message::binary(gleaner_openpi::reply(&reply))).await.unwrap();
                }
            });
        }
    });
    (policy, AbortOnDropHandle::new(serving))
}

/// A client of the deployment that has read the metadata. `None` if the server admits no further one.
async fn connect(address: SocketAddr) -> Option<WebSocketStream<TcpStream>> {
    let stream = TcpStream::connect(address).await.unwrap();
    match client_async(format!("ws://{address}/{DEPLOYMENT}"), stream).await {
        Ok((mut socket, _)) => {
            assert!(matches!(socket.next().await, Some(Ok(Message::Binary(_)))));
            Some(socket)
        }
        Err(tungstenite::Error::Http(response)) => {
            assert_eq!(response.status(), ::http::StatusCode::TOO_MANY_REQUESTS);
            None
        }
        Err(error) => panic!("{error}"),
    }
}

/// Sends an observation; returns the values of the reply.
async fn act(socket: &mut WebSocketStream<TcpStream>) -> Vec<f32> {
    let observation = gleaner_openpi::observation(&[("observation/state", Value::Numbers(&[1.0, 0.0]))]);
    socket.send(Message::binary(observation)).await.unwrap();
    loop {
        let message = socket.next().await.unwrap().unwrap();
        if let Message::Binary(reply) = message {
            return gleaner_openpi::actions(&reply, "actions").unwrap().1;
        }
        assert!(message.is_ping(), "{message:?}");
    }
}

/// Reads without an end, and so answers pings.
async fn answer_pings(socket: &mut WebSocketStream<TcpStream>) {
    loop {
        let message = socket.next().await;
        assert!(matches!(message, Some(Ok(Message::Ping(_)))), "{message:?}");
    }
}

fn sessions(services: &Services) -> Vec<SessionId> {
    services.policies.live().into_iter().map(|(session, _)| session.id).collect()
}

/// The two clients are the most that the server admits; one of them stops reading, and so answers no ping.
#[tokio::test]
async fn session_of_a_client_that_answers_no_ping_ends_and_that_of_a_slow_client_does_not() {
    let dir = tempfile::tempdir().unwrap();
    let data = ["gleaner-server", "serve", "--workers", "0", "--data-dir", dir.path().to_str().unwrap()];
    let limits = ["--keepalive-timeout", "1", "--session-idle-seconds", "3600", "--calls-at-once", "2"];
    let cli = Cli::try_parse_from([&data[..], &limits, &["--policy-servers", "127.0.0.1"]].concat()).unwrap();
    let Command::Serve(config) = cli.command else { panic!("not serve") };
    let services = Services::open(*config, ([127, 0, 0, 1], 1).into()).await.unwrap();
    let task = testing::task(&services.store).await;
    let (remote, _policy_server) = policy_server(&task).await;
    let policy = services.policies.register(&task, remote).await.unwrap();
    services.policies.deploy(DEPLOYMENT, Assignment::of(&policy.id)).await.unwrap();
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap();
    let tokens = TokenCache::open(services.store.clone()).await.unwrap();
    let _serving = open(services.clone(), listener, None, tokens).unwrap();

    let mut slow = connect(address).await.unwrap();
    assert_eq!(act(&mut slow).await, [0.5]);
    let [slow_session] = <[SessionId; 1]>::try_from(sessions(&services)).unwrap();
    let freed = async {
        let mut lost = connect(address).await.unwrap();
        let both = sessions(&services);
        assert_eq!(both.len(), 2);
        tokio::select! {
            () = answer_pings(&mut lost) => unreachable!(),
            third = connect(address) => assert!(third.is_none(), "the two are the most"),
        }
        let mut attempts = tokio::time::interval(Duration::from_millis(50));
        loop {
            attempts.tick().await;
            let is_over = sessions(&services).iter().all(|id| !both.contains(id) || *id == slow_session);
            if is_over && let Some(mut next) = connect(address).await {
                // Its session would end too if it were not read meanwhile.
                return tokio::select! {
                    () = answer_pings(&mut next) => unreachable!(),
                    ended = services.store.audit(Millis(0), 100) => ended.unwrap(),
                };
            }
        }
    };
    let ended = tokio::select! {
        () = answer_pings(&mut slow) => unreachable!(),
        ended = tokio::time::timeout(BOUND, freed) => ended.expect("the place of the lost client is free"),
    };
    let ended: Vec<&str> = ended.iter().map(|entry| entry.outcome.as_str()).collect();
    assert_eq!(ended, ["Late"]);
    assert_eq!(act(&mut slow).await, [0.5]);
    assert!(sessions(&services).contains(&slow_session));
}
