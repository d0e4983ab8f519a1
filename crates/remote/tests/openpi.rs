//! openpi servers of every kind: one that answers, and those that answer with something else, too much, or nothing.

#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

mod support;

use std::{
    future::pending,
    sync::{
        Arc,
        atomic::{AtomicUsize, Ordering::SeqCst},
    },
};

use futures::{SinkExt as _, StreamExt as _};
use gleaner_core::{
    error::Kind,
    remote::{Protocol, RemotePolicy},
};
use gleaner_remote::Outgoing;
use rmpv::Value;
use support::{
    act, acts,
    openpi::{Socket, actions, array, floats, listen, packed, state},
    outgoing, policy, remote,
};
use tokio::{io::AsyncWriteExt as _, net::TcpSocket};
use tokio_tungstenite::{
    accept_async, accept_hdr_async,
    tungstenite::{
        Message,
        handshake::server::{ErrorResponse, Request, Response},
        protocol::frame::{
            Frame,
            coding::{Data, OpCode},
        },
    },
};

/// A server that describes itself, and has `answer` reply.
async fn answering<F: Future<Output = ()> + Send + 'static>(
    answer: impl Fn(Socket, Value) -> F + Copy + Send + Sync + 'static,
) -> String {
    listen(move |stream| async move {
        let mut socket = accept_async(stream).await.unwrap();
        socket.send(Message::binary(packed(&Value::Map(vec![])))).await.unwrap();
        let Some(Ok(Message::Binary(request))) = socket.next().await else { return };
        answer(socket, rmpv::decode::read_value(&mut &request[..]).unwrap()).await;
    })
    .await
}

/// The error of the first observation.
async fn refusal(address: &str) -> (Kind, String) {
    refusal_of(policy(Protocol::Openpi, address), address).await
}

async fn refusal_of(policy: RemotePolicy, address: &str) -> (Kind, String) {
    let remote = remote(policy, outgoing());
    let error = act(&mut remote.episode(), 1.0).await.unwrap_err();
    assert!(error.message().contains(address), "{error} names no address");
    (error.kind(), error.message().to_owned())
}

#[tokio::test]
async fn a_session_is_a_connection_and_every_observation_is_answered() {
    static CONNECTIONS: AtomicUsize = AtomicUsize::new(0);
    let address = listen(|stream| async move {
        CONNECTIONS.fetch_add(1, SeqCst);
        let mut socket = accept_async(stream).await.unwrap();
        socket.send(Message::binary(packed(&Value::Map(vec![])))).await.unwrap();
        while let Some(Ok(message)) = socket.next().await {
            // The answer to a ping is no observation.
            let Message::Binary(request) = message else { continue };
            let state = state(&rmpv::decode::read_value(&mut &request[..]).unwrap());
            // Strictly one answer; a ping in between does not count.
            socket.send(Message::Ping(vec![1].into())).await.unwrap();
            socket.send(actions(array("<f4", &[1, 2], state))).await.unwrap();
        }
    })
    .await;
    let remote = remote(policy(Protocol::Openpi, &address), outgoing());
    remote.check().await.unwrap();
    let (mut one, mut other) = (remote.episode(), remote.episode());
    for value in [1.0, 2.0] {
        assert_eq!(act(&mut one, value).await.unwrap(), [[value, 0.5]]);
        assert_eq!(act(&mut other, -value).await.unwrap(), [[-value, 0.5]]);
    }
    assert_eq!(CONNECTIONS.load(SeqCst), 3);
}

#[tokio::test]
async fn answers_that_are_not_actions_are_refused() {
    type Wrong = (fn() -> Message, &'static str);
    let wrong: [Wrong; 10] = [
        (|| Message::text("Traceback …\nKeyError: 'observation/image\u{1b}'"), "KeyError: 'observation/image\\u{1b}'"),
        (|| Message::binary(vec![0x81]), "is not msgpack"),
        (|| Message::binary(packed(&Value::Nil)), "not one msgpack map"),
        (|| Message::binary(packed(&Value::Map(vec![]))), "actions: is missing"),
        (|| actions(Value::Array(vec![1.into()])), "must be a numpy array"),
        (|| actions(array("|O", &[1, 2], vec![0; 16])), "has the type \"|O\""),
        (|| actions(array("<f4", &[1, 3], floats(&[0.0; 3]))), "shape [1, 3]"),
        (|| actions(array("<f4", &[5, 2], floats(&[0.0; 10]))), "has 5 actions"),
        (|| actions(array("<f4", &[2, 2], floats(&[0.0, f32::NAN, 0.0, 0.0]))), "is NaN"),
        (|| Message::binary(vec![0; 1 << 20]), "larger than actions are"),
    ];
    for (message, words) in wrong {
        let address = listen(move |stream| async move {
            let mut socket = accept_async(stream).await.unwrap();
            socket.send(Message::binary(packed(&Value::Map(vec![])))).await.unwrap();
            while let Some(Ok(Message::Binary(_))) = socket.next().await {
                // The client may have closed before the end of a long message.
                let _ = socket.send(message()).await;
            }
        })
        .await;
        let (kind, message) = refusal(&address).await;
        assert_eq!(kind, Kind::Precondition, "{message}");
        assert!(message.contains(words) && message.len() < 800, "{words} expected: {message}");
    }
}

#[tokio::test]
async fn a_server_that_sends_without_end_or_not_at_all_is_left_in_time() {
    let silent = answering(|socket, _| async move {
        let _open = socket;
        pending::<()>().await;
    })
    .await;
    let pings =
        answering(
            |mut socket, _| async move { while socket.send(Message::Ping(vec![0; 100].into())).await.is_ok() {} },
        )
        .await;
    for address in [silent, pings] {
        let limited = RemotePolicy { answer_within_ms: 500, ..policy(Protocol::Openpi, &address) };
        let (kind, message) = refusal_of(limited, &address).await;
        assert_eq!(kind, Kind::Unavailable, "{message}");
        assert!(message.contains("no answer within 500 ms"), "{message}");
    }
    // A message in fragments without a last one is as long as it is.
    let fragments = answering(|mut socket, _| async move {
        let frame = |code| Message::Frame(Frame::message(vec![0; 4096], OpCode::Data(code), false));
        if socket.send(frame(Data::Binary)).await.is_err() {
            return;
        }
        while socket.send(frame(Data::Continue)).await.is_ok() {}
    })
    .await;
    let (kind, message) = refusal(&fragments).await;
    assert_eq!(kind, Kind::Precondition, "{message}");
    assert!(message.contains("larger than actions are"), "{message}");
}

#[tokio::test]
async fn servers_of_another_kind_are_named() {
    let not_http = listen(|mut stream| async move {
        let _ = stream.write_all(b"SSH-2.0-OpenSSH\r\n\r\n").await;
    })
    .await;
    let closed = listen(|stream| async move { drop(accept_async(stream).await) }).await;
    let unavailable = listen(|mut stream| async move {
        let _ = stream.write_all(b"HTTP/1.1 503 Service Unavailable\r\ncontent-length: 0\r\n\r\n").await;
    })
    .await;
    for address in [not_http, closed, unavailable] {
        assert_eq!(refusal(&address).await.0, Kind::Unavailable);
    }
    for (first, words) in [
        (Message::text("no such policy"), "answered with an error: no such policy"),
        (Message::binary(vec![0x81]), "is not msgpack"),
    ] {
        let address = listen(move |stream| {
            let first = first.clone();
            async move {
                let mut socket = accept_async(stream).await.unwrap();
                let _ = socket.send(first).await;
                while socket.next().await.is_some_and(|message| message.is_ok()) {}
            }
        })
        .await;
        let (kind, message) = refusal(&address).await;
        assert!(kind == Kind::Precondition && message.contains(words), "{message}");
    }
}

#[tokio::test]
async fn a_token_is_an_api_key_and_is_never_in_an_error() {
    let address = listen(|stream| async move {
        #[expect(clippy::result_large_err, reason = "the signature is tungstenite's")]
        let check = |request: &Request, response: Response| match request.headers().get("authorization") {
            Some(key) if key == "Api-Key good-secret" => Ok(response),
            _ => {
                let mut refused = ErrorResponse::new(Some("wrong key".to_owned()));
                *refused.status_mut() = http::StatusCode::UNAUTHORIZED;
                Err(refused)
            }
        };
        let Ok(mut socket) = accept_hdr_async(stream, check).await else { return };
        let _ = socket.send(Message::binary(packed(&Value::Map(vec![])))).await;
        while let Some(Ok(Message::Binary(_))) = socket.next().await {
            let _ = socket.send(actions(array("<f8", &[1, 2], vec![0; 16]))).await;
        }
    })
    .await;
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("tokens");
    std::fs::write(&file, "127.0.0.1 bad-secret\n").unwrap();
    let remote = remote(policy(Protocol::Openpi, &address), Outgoing { tokens: Some(file.clone()), ..outgoing() });
    let error = remote.check().await.unwrap_err();
    assert_eq!(error.kind(), Kind::Precondition);
    assert!(error.message().contains("401") && !error.message().contains("secret"), "{error}");
    assert!(!format!("{remote:?}").contains("secret"));
    // Read again for the next connection.
    std::fs::write(&file, "127.0.0.1 good-secret\n").unwrap();
    remote.check().await.unwrap();
}

/// A dead server costs one attempt, and a robot no time; when it is back, sessions resume.
#[tokio::test]
async fn a_session_resumes_when_its_server_is_back() {
    // Connections are refused until it listens, and no other program gets its port.
    let socket = TcpSocket::new_v4().unwrap();
    socket.bind(([127, 0, 0, 1], 0).into()).unwrap();
    let address = format!("ws://{}", socket.local_addr().unwrap());
    let remote = remote(policy(Protocol::Openpi, &address), outgoing());
    let mut episode = remote.episode();
    for _ in 0..3 {
        let error = act(&mut episode, 1.0).await.unwrap_err();
        assert_eq!(error.kind(), Kind::Unavailable);
        assert!(error.message().contains(&address) && error.message().contains("start it"), "{error}");
    }
    let listener = socket.listen(16).unwrap();
    let seen = Arc::new(AtomicUsize::new(0));
    let count = Arc::clone(&seen);
    tokio::spawn(async move {
        while let Ok((stream, _)) = listener.accept().await {
            count.fetch_add(1, SeqCst);
            let mut socket = accept_async(stream).await.unwrap();
            socket.send(Message::binary(packed(&Value::Map(vec![])))).await.unwrap();
            let Some(Ok(Message::Binary(_))) = socket.next().await else { continue };
            socket.send(actions(array("<f4", &[2], floats(&[7.0, 8.0])))).await.unwrap();
            // It ends the connection instead of an answer.
            let _ = socket.next().await;
        }
    });
    assert_eq!(acts(&mut episode, 1.0).await, [[7.0, 8.0]]);
    assert_eq!(seen.load(SeqCst), 1);
    assert_eq!(act(&mut episode, 1.0).await.unwrap_err().kind(), Kind::Unavailable, "the connection ended");
}
