//! Peers that hold connections without using them.

use std::{
    convert::Infallible,
    io::ErrorKind,
    net::SocketAddr,
    pin::Pin,
    task::{Context, Poll},
    time::Duration,
};

use bytes::Bytes;
use futures::StreamExt as _;
use http_body::{Body as _, Frame};
use tokio::{
    io::{AsyncReadExt as _, AsyncWriteExt as _, DuplexStream, duplex},
    net::{TcpListener, TcpStream},
    time::{Instant, timeout},
};
use tokio_util::sync::CancellationToken;

use crate::{
    accept::incoming,
    body::ResponseBody,
    connection::{Connection, Terms},
    connections::affordable,
    permits::Permits,
    *,
};

const FIRST_CALL: Duration = Duration::from_secs(8);
const STALL: Duration = Duration::from_secs(30);
const LONG: Duration = Duration::from_secs(3600);

/// Limits for tests.
pub(crate) fn config() -> EdgeConfig {
    EdgeConfig {
        max_connections: 8,
        max_connections_per_address: 4,
        first_call: FIRST_CALL,
        keepalive_timeout: STALL,
        write_timeout: STALL,
        min_bytes_per_second: 4096,
        slow: FIRST_CALL,
        calls_per_second: 1000,
        calls_at_once: 2048,
        unary_calls_per_second: 350,
        unary_calls_at_once: 3,
    }
}

fn connections(config: EdgeConfig) -> Connections<u8> {
    let rules = CallRules { is_unary: |_| true, is_self_paced: |_| false, status: |_| tonic::Status::ok("") };
    Connections::new(config, rules)
}

/// A watched connection, its peer's end, and the token that cuts it.
fn watched() -> (Connection<DuplexStream>, DuplexStream, CancellationToken) {
    let (ours, theirs) = duplex(16);
    let peer: SocketAddr = "10.0.0.1:1".parse().unwrap();
    let cut = CancellationToken::new();
    let terms = Terms { first_call_by: Instant::now() + FIRST_CALL, write_timeout: STALL, cut: cut.clone() };
    let permit = Permits::new(1, 1).take(peer.ip()).ok().unwrap();
    (Connection::new(ours, ConnectionState::new(peer), permit, terms), theirs, cut)
}

/// Timers have steps of a millisecond.
fn about(time: Duration, limit: Duration) -> bool {
    time >= limit && time < limit + Duration::from_millis(5)
}

#[tokio::test(start_paused = true)]
async fn a_connection_without_a_call_ends_whatever_is_sent_on_it() {
    let (mut ours, mut theirs, _cut) = watched();
    let begun = Instant::now();
    let drip = tokio::spawn(async move {
        while theirs.write_all(b"x").await.is_ok() {
            tokio::time::sleep(Duration::from_secs(1)).await;
        }
    });
    let ended = loop {
        match ours.read_u8().await {
            Ok(_) => {}
            Err(error) => break error,
        }
    };
    assert_eq!(ended.kind(), ErrorKind::TimedOut);
    assert!(about(begun.elapsed(), FIRST_CALL));
    drop(ours);
    drip.await.unwrap();
}

#[tokio::test(start_paused = true)]
async fn a_connection_with_a_call_may_be_silent_and_its_bytes_are_counted() {
    let (mut ours, mut theirs, _cut) = watched();
    ours.state().note_call();
    theirs.write_all(b"abc").await.unwrap();
    let mut read = [0; 3];
    ours.read_exact(&mut read).await.unwrap();
    assert_eq!(ours.state().received(), 3);
    assert!(timeout(LONG, ours.read_u8()).await.is_err(), "the pings of the transport detect a lost peer");
}

#[tokio::test(start_paused = true)]
async fn a_peer_that_reads_nothing_is_closed_and_a_slow_one_is_not() {
    let (mut ours, _theirs, _cut) = watched();
    ours.state().note_call();
    let begun = Instant::now();
    assert_eq!(ours.write_all(&[0; 100]).await.unwrap_err().kind(), ErrorKind::TimedOut);
    assert!(about(begun.elapsed(), STALL));

    let (mut ours, mut theirs, _cut) = watched();
    ours.state().note_call();
    let slow = tokio::spawn(async move {
        let mut taken = 0;
        while theirs.read_u8().await.is_ok() {
            taken += 1;
            tokio::time::sleep(STALL / 2).await;
        }
        taken
    });
    ours.write_all(&[0; 100]).await.unwrap();
    drop(ours);
    assert_eq!(slow.await.unwrap(), 100);
}

#[tokio::test(start_paused = true)]
async fn a_response_left_unread_ends_its_connection() {
    let (mut ours, _theirs, _cut) = watched();
    ours.state().note_call();
    let (taken, left) = (ours.state().pending().begin(), ours.state().pending().begin());
    tokio::time::sleep(STALL / 2).await;
    taken.piece_sent();
    left.piece_sent();
    taken.piece_read();
    let begun = Instant::now();
    assert_eq!(ours.read_u8().await.unwrap_err().kind(), ErrorKind::TimedOut);
    assert!(about(begun.elapsed(), STALL));
    drop(left);
    assert_eq!(ours.state().pending().oldest(), None, "a finished response is forgotten");
}

#[tokio::test(start_paused = true)]
async fn an_unread_response_ends_a_connection_that_is_being_written_to() {
    let (mut ours, mut theirs, _cut) = watched();
    ours.state().note_call();
    let left = ours.state().pending().begin();
    left.piece_sent();
    let reads = tokio::spawn(async move { while theirs.read_u8().await.is_ok() {} });
    let begun = Instant::now();
    let ended = loop {
        if let Err(error) = ours.write_all(b"ping").await {
            break error;
        }
        tokio::time::sleep(Duration::from_secs(1)).await;
    };
    assert_eq!(ended.kind(), ErrorKind::TimedOut);
    assert!(begun.elapsed() < STALL + Duration::from_secs(2));
    drop(ours);
    reads.await.unwrap();
}

/// A body of frames of these lengths, the last one first.
struct Frames(Vec<usize>);

impl http_body::Body for Frames {
    type Data = Bytes;
    type Error = Infallible;

    fn poll_frame(mut self: Pin<&mut Self>, _cx: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, Infallible>>> {
        Poll::Ready(self.0.pop().map(|length| Ok(Frame::data(vec![7; length].into()))))
    }
}

#[tokio::test]
async fn a_large_response_is_sent_in_pieces() {
    let mut answer = ResponseBody::new(Frames(vec![4, 10, 3]), 4, None, None);
    let mut pieces = Vec::new();
    while let Some(frame) = std::future::poll_fn(|cx| Pin::new(&mut answer).poll_frame(cx)).await {
        pieces.push(frame.unwrap().into_data().unwrap());
    }
    let lengths: Vec<usize> = pieces.iter().map(Bytes::len).collect();
    assert_eq!(lengths, [3, 4, 4, 2, 4]);
}

#[test]
fn connections_leave_descriptors_for_other_uses() {
    assert_eq!(affordable(4096, None), 4096);
    assert_eq!(affordable(4096, Some(1024)), 768);
    assert_eq!(affordable(4096, Some(100)), 1);
    assert_eq!(affordable(64, Some(1024)), 64);
}

#[tokio::test(start_paused = true)]
async fn every_connection_can_be_cut() {
    let (mut ours, _theirs, cut) = watched();
    ours.state().note_call();
    let (ended, ()) = tokio::join!(ours.read_u8(), async { cut.cancel() });
    assert_eq!(ended.unwrap_err().kind(), ErrorKind::ConnectionAborted);
}

async fn listen() -> (TcpListener, SocketAddr) {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap();
    (listener, address)
}

/// Whether a peer's last read finds the connection closed.
async fn ended(stream: &mut TcpStream) -> bool {
    matches!(timeout(LONG, stream.read(&mut [0; 8])).await.unwrap(), Ok(0) | Err(_))
}

#[tokio::test]
async fn a_connection_above_the_limit_is_closed_and_the_next_gets_its_permit() {
    let config = EdgeConfig { max_connections_per_address: 2, ..config() };
    let (listener, address) = listen().await;
    let mut incoming = connections(config).accept(listener, None, Protocol::Http2);
    let mut peers = Vec::new();
    let mut kept = Vec::new();
    for _ in 0..2 {
        peers.push(TcpStream::connect(address).await.unwrap());
        kept.push(incoming.next().await.unwrap().unwrap());
    }
    assert!(ended(&mut TcpStream::connect(address).await.unwrap()).await);
    kept.pop();
    assert!(ended(&mut peers[1]).await);
    let _next = TcpStream::connect(address).await.unwrap();
    incoming.next().await.unwrap().unwrap();
}

#[tokio::test]
async fn an_endless_handshake_delays_no_other_connection_and_is_ended() {
    let connections = connections(EdgeConfig { first_call: Duration::from_secs(1), ..config() });
    let (listener, address) = listen().await;
    let mut incoming = incoming(connections.rules(), listener, |mut stream| async move {
        stream.read_u8().await?;
        Ok(stream)
    });
    let mut silent = TcpStream::connect(address).await.unwrap();
    let mut good = TcpStream::connect(address).await.unwrap();
    good.write_all(b"hello").await.unwrap();
    let through = incoming.next().await.unwrap().unwrap();
    assert_eq!(through.state().peer(), good.local_addr().unwrap());
    assert!(ended(&mut silent).await);
}
