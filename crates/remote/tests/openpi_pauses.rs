//! openpi servers that ping, or end a session, while no observation waits for its answer.

#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

mod support;

use std::{
    sync::{
        Arc,
        atomic::{AtomicU8, Ordering::SeqCst},
    },
    time::Duration,
};

use futures::{SinkExt as _, StreamExt as _};
use gleaner_core::{error::Kind, remote::Protocol};
use gleaner_remote::Episode;
use rmpv::Value;
use support::{
    act,
    openpi::{Socket, actions, array, floats, listen, packed},
    outgoing, policy, remote,
};
use tokio::{sync::mpsc, time::timeout};
use tokio_tungstenite::{
    accept_async,
    tungstenite::{Error, Message, error::ProtocolError},
};

/// Far more than any event takes on a busy machine.
const BOUND: Duration = Duration::from_mins(2);

/// A server whose actions are the number of the connection and that of the observation within it. After the first answer
/// of all, it sends `pause`; it then reports the messages that it received until the next observation or the end.
async fn pausing(pause: &[Message]) -> (String, mpsc::UnboundedReceiver<Vec<Message>>) {
    let (report, reports) = mpsc::unbounded_channel();
    let (connections, pause) = (Arc::new(AtomicU8::new(0)), pause.to_vec());
    let address = listen(move |stream| {
        let (connection, pause, report) = (connections.fetch_add(1, SeqCst) + 1, pause.clone(), report.clone());
        async move {
            let mut socket = accept_async(stream).await.unwrap();
            socket.send(Message::binary(packed(&Value::Map(vec![])))).await.unwrap();
            for observation in 1_u8.. {
                let Some(Ok(Message::Binary(_))) = socket.next().await else { return };
                let values = [f32::from(connection), f32::from(observation)];
                socket.send(actions(array("<f4", &[2], floats(&values)))).await.unwrap();
                if (connection, observation) == (1, 1) {
                    report.send(paused(&mut socket, &pause).await).unwrap();
                }
            }
        }
    })
    .await;
    (address, reports)
}

/// Sends messages; returns those of the client: one for each ping, or all until it is gone.
async fn paused(socket: &mut Socket, pause: &[Message]) -> Vec<Message> {
    let mut received = Vec::new();
    for message in pause {
        socket.send(message.clone()).await.unwrap();
        if message.is_ping() {
            received.push(socket.next().await.unwrap().unwrap());
        }
    }
    if !pause.iter().all(Message::is_ping) {
        while let Some(message) = socket.next().await {
            match message {
                Ok(message) => received.push(message),
                Err(Error::Io(_) | Error::Protocol(ProtocolError::ResetWithoutClosingHandshake)) => break,
                Err(error) => panic!("{error}"),
            }
        }
    }
    received
}

/// A session whose first observation was answered, with the messages that the server received afterwards without another.
async fn after_the_pause(pause: &[Message]) -> (Episode, Vec<Message>) {
    let (address, mut reports) = pausing(pause).await;
    let mut episode = remote(policy(Protocol::Openpi, &address), outgoing()).episode();
    assert_eq!(act(&mut episode, 1.0).await.unwrap(), [[1.0, 1.0]]);
    // In time only if the client reads between observations.
    let received = timeout(BOUND, reports.recv()).await.unwrap().unwrap();
    (episode, received)
}

#[tokio::test]
async fn pings_between_observations_are_answered_and_the_session_is_kept() {
    let pings = [1, 2, 3].map(|number| Message::Ping(vec![number].into()));
    let (mut episode, received) = after_the_pause(&pings).await;
    assert_eq!(received, [1, 2, 3].map(|number| Message::Pong(vec![number].into())));
    assert_eq!(act(&mut episode, 1.0).await.unwrap(), [[1.0, 2.0]]);
}

#[tokio::test]
async fn a_session_that_its_server_ended_between_observations_is_replaced() {
    let ends = [vec![Message::text("no observation for 60 s"), Message::Close(None)], vec![Message::Close(None)]];
    for end in ends {
        let (mut episode, received) = after_the_pause(&end).await;
        assert!(!received.iter().any(Message::is_binary), "{received:?}");
        assert_eq!(act(&mut episode, 1.0).await.unwrap(), [[2.0, 1.0]]);
        assert_eq!(act(&mut episode, 1.0).await.unwrap(), [[2.0, 2.0]]);
    }
}

/// Each further answer would be that of the observation before.
#[tokio::test]
async fn a_server_that_answers_twice_is_refused() {
    let (mut episode, _) = after_the_pause(&[actions(array("<f4", &[2], floats(&[0.0; 2])))]).await;
    let error = act(&mut episode, 1.0).await.unwrap_err();
    assert_eq!(error.kind(), Kind::Precondition, "{error}");
    assert!(error.message().contains("answers no observation"), "{error}");
}
