//! Peers that exceed their limits: silent and half-open connections, slow uploads, frequent calls, too many streams.

mod unread;

use std::time::{Duration, Instant};

use futures::{StreamExt as _, future::join_all, stream};
use gleaner_proto::v1::*;
use tokio::{
    io::{AsyncReadExt as _, AsyncWriteExt as _},
    net::TcpStream,
    sync::mpsc,
    time::timeout,
};
use tokio_stream::wrappers::ReceiverStream;
use tonic::Code;

use crate::support::{
    api::Api,
    lab::{self, RECORDINGS},
    server::TestServer,
    wait::until,
};

/// The first bytes of an HTTP/2 client, and the empty settings that follow.
const PREFACE: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n";
const SETTINGS: &[u8] = &[0, 0, 0, 4, 0, 0, 0, 0, 0];
/// Well above the limits that these tests set, on a machine that is busy with other tests.
const BOUND: Duration = Duration::from_secs(30);

/// Opens a connection, sends these bytes and waits until the server closes it.
async fn send_and_wait(address: &str, bytes: &[u8]) {
    let mut stream = TcpStream::connect(address).await.unwrap();
    stream.write_all(bytes).await.unwrap();
    let mut response = Vec::new();
    // A reset is an end too.
    let _ = timeout(BOUND, stream.read_to_end(&mut response)).await.expect("the server closes the connection");
}

#[tokio::test]
async fn silent_and_half_open_connections_are_closed_and_others_are_not() {
    let server = TestServer::start_with(&["--first-call-seconds", "1"]).await;
    let address = server.address();
    // On a busy machine, the limit of a connection may pass before its first call.
    let mut api = until("a first call is in time", async || {
        let mut api = Api::connect(&server).await;
        api.tasks.list_tasks(ListTasksRequest::default()).await.is_ok().then_some(api)
    })
    .await;
    lab::create_task(&mut api).await;
    let greeting = [PREFACE, SETTINGS].concat();
    let words: [&[u8]; 5] = [b"", &PREFACE[..10], PREFACE, &greeting, b"GET / HTTP/1.1\r\nHost: x\r\n\r\n"];
    let hostile = words.iter().cycle().take(100).map(|words| send_and_wait(address, words));
    let watched = api.tasks.list_tasks(ListTasksRequest::default());
    let (_, tasks) = tokio::join!(join_all(hostile), watched);
    assert_eq!(tasks.unwrap().into_inner().tasks.len(), 1);
    // The same connection, which is older than any of the others became.
    assert_eq!(api.tasks.list_tasks(ListTasksRequest::default()).await.unwrap().into_inner().tasks.len(), 1);
}

#[tokio::test]
async fn upload_below_minimum_rate_is_closed_and_can_be_resumed() {
    let (_server, mut api) = lab::with_task(&["--slow-seconds", "1", "--min-bytes-per-second", "100000"]).await;
    let recording = &RECORDINGS[0];
    let upload_id = lab::start(&mut api, lab::TASK, recording).await.unwrap().upload_id;
    let (id, bytes) = (upload_id.clone(), recording.bytes.clone());
    let ticks = tokio::time::interval(Duration::from_millis(100));
    let slow = stream::unfold((ticks, 0), move |(mut ticks, at)| {
        let (upload_id, data) = (id.clone(), bytes.slice(at..at + 10));
        async move {
            ticks.tick().await;
            Some((WriteUploadRequest { upload_id, offset: at.try_into().unwrap(), data }, (ticks, at + 10)))
        }
    });
    let begun = Instant::now();
    let error = timeout(BOUND, api.episodes.write_upload(slow)).await.unwrap().unwrap_err();
    assert_eq!(error.code(), Code::DeadlineExceeded, "{error}");
    assert!(error.message().contains("--min-bytes-per-second"), "{error}");
    assert!(begun.elapsed() >= Duration::from_secs(1));

    assert!(api.committed_size(&upload_id).await.unwrap() > 0, "the received bytes are kept");
    // On a busy machine, the rest may be too slow as well.
    until("the upload is complete", async || {
        let committed = api.committed_size(&upload_id).await.unwrap();
        let rest = recording.bytes.slice(usize::try_from(committed).unwrap()..);
        if rest.is_empty() {
            return Some(committed);
        }
        let written = lab::write(&mut api, &upload_id, committed, rest).await;
        written.inspect_err(|error| assert_eq!(error.code(), Code::DeadlineExceeded, "{error}")).ok()
    })
    .await;
    lab::finish(&mut api, &upload_id).await.unwrap();
}

#[tokio::test]
async fn call_above_the_rate_fails_with_the_time_to_retry() {
    let server = TestServer::start_with(&["--calls-per-second", "1"]).await;
    let mut api = Api::connect(&server).await;
    let mut rejected = None;
    for _ in 0..20 {
        if let Err(status) = api.tasks.list_tasks(ListTasksRequest::default()).await {
            rejected = Some(status);
            break;
        }
    }
    let rejected = rejected.expect("twenty calls at once are more than one a second");
    assert_eq!(rejected.code(), Code::ResourceExhausted, "{rejected}");
    let words = rejected.message().split("retry in ").nth(1).unwrap();
    let wait: u64 = words.split(' ').next().unwrap().parse().unwrap();
    assert!((1..=1000).contains(&wait), "{rejected}");
    assert!(rejected.metadata().contains_key("request-id"), "{rejected:?}");
}

#[tokio::test]
async fn concurrent_streams_of_a_client_are_limited() {
    let (server, mut api) = lab::with_task(&["--calls-at-once", "2"]).await;
    let mut held = Vec::new();
    for _ in 0..2 {
        // On separate connections, because the limit applies to the client.
        let mut other = Api::connect(&server).await;
        let (requests, receiver) = mpsc::channel::<SessionRequest>(1);
        held.push((requests, other.policies.session(ReceiverStream::new(receiver)).await.unwrap()));
    }
    let rejected = api.tasks.list_tasks(ListTasksRequest::default()).await.unwrap_err();
    assert_eq!(rejected.code(), Code::ResourceExhausted, "{rejected}");
    assert!(rejected.message().contains("--calls-at-once"), "{rejected}");
    let (requests, responses) = held.pop().unwrap();
    drop(requests);
    let mut responses = responses.into_inner();
    while let Some(Ok(_)) = responses.next().await {}
    drop(responses);
    // The client receives the end before the server has counted it.
    for _ in 0..40 {
        match api.tasks.list_tasks(ListTasksRequest::default()).await {
            Ok(_) => return,
            Err(status) => assert_eq!(status.code(), Code::ResourceExhausted, "{status}"),
        }
    }
    panic!("a stream that has ended is still counted");
}
