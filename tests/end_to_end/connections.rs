//! Peers that take more than their share: silent, half-open and dripping ones, and ones that call too often.

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

use crate::{
    api::Api,
    lab::{self, RECORDINGS},
    server::TestServer,
};

/// What an HTTP/2 client says first, and the empty settings that follow it.
const PREFACE: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n";
const SETTINGS: &[u8] = &[0, 0, 0, 4, 0, 0, 0, 0, 0];
/// Well above the limits of these tests, whatever else the machine does.
const PATIENCE: Duration = Duration::from_secs(30);

/// Opens a connection that says so much and then nothing; ends when the server has closed it.
async fn say_and_wait(address: &str, words: &[u8]) {
    let mut stream = TcpStream::connect(address).await.unwrap();
    stream.write_all(words).await.unwrap();
    let mut answer = Vec::new();
    // Thrown out or shut: either is an end.
    let _ = timeout(PATIENCE, stream.read_to_end(&mut answer)).await.expect("the server closes the connection");
}

#[tokio::test]
async fn silent_and_half_open_connections_are_closed_and_others_are_not() {
    let server = TestServer::start_with(&["--first-call-seconds", "1"]).await;
    let address = server.url().strip_prefix("http://").unwrap();
    let mut api = Api::connect(&server).await;
    lab::create_task(&mut api).await;
    let greeted = [PREFACE, SETTINGS].concat();
    let words: [&[u8]; 5] = [b"", &PREFACE[..10], PREFACE, &greeted, b"GET / HTTP/1.1\r\nHost: x\r\n\r\n"];
    let hostile = words.iter().cycle().take(100).map(|words| say_and_wait(address, words));
    let watched = api.tasks.list_tasks(ListTasksRequest::default());
    let (_, tasks) = tokio::join!(join_all(hostile), watched);
    assert_eq!(tasks.unwrap().into_inner().tasks.len(), 1);
    // The same connection, older now than any of those could become.
    assert_eq!(api.tasks.list_tasks(ListTasksRequest::default()).await.unwrap().into_inner().tasks.len(), 1);
}

#[tokio::test]
async fn an_upload_that_drips_is_ended_and_can_be_gone_on_with() {
    let server = TestServer::start_with(&["--slow-seconds", "1", "--min-bytes-per-second", "100000"]).await;
    let mut api = Api::connect(&server).await;
    lab::create_task(&mut api).await;
    let recording = &RECORDINGS[0];
    let upload_id = lab::start(&mut api, lab::TASK, recording).await.unwrap().upload_id;
    let (id, bytes) = (upload_id.clone(), recording.bytes.clone());
    let ticks = tokio::time::interval(Duration::from_millis(100));
    let drip = stream::unfold((ticks, 0), move |(mut ticks, at)| {
        let (upload_id, data) = (id.clone(), bytes.slice(at..at + 10));
        async move {
            ticks.tick().await;
            Some((WriteUploadRequest { upload_id, offset: at.try_into().unwrap(), data }, (ticks, at + 10)))
        }
    });
    let begun = Instant::now();
    let error = timeout(PATIENCE, api.episodes.write_upload(drip)).await.unwrap().unwrap_err();
    assert_eq!(error.code(), Code::DeadlineExceeded, "{error}");
    assert!(error.message().contains("--min-bytes-per-second"), "{error}");
    assert!(begun.elapsed() >= Duration::from_secs(1));

    let request = GetUploadRequest { upload_id: upload_id.clone() };
    let committed = api.episodes.get_upload(request).await.unwrap().into_inner().committed_size;
    assert!(committed > 0, "what had come is kept");
    let rest = recording.bytes.slice(usize::try_from(committed).unwrap()..);
    lab::write(&mut api, &upload_id, committed, rest).await.unwrap();
    lab::finish(&mut api, &upload_id).await.unwrap();
}

#[tokio::test]
async fn who_calls_too_often_is_told_when_to_call_again() {
    let server = TestServer::start_with(&["--calls-per-second", "1"]).await;
    let mut api = Api::connect(&server).await;
    let mut refused = None;
    for _ in 0..20 {
        if let Err(status) = api.tasks.list_tasks(ListTasksRequest::default()).await {
            refused = Some(status);
            break;
        }
    }
    let refused = refused.expect("twenty calls at once are more than one a second");
    assert_eq!(refused.code(), Code::ResourceExhausted, "{refused}");
    let words = refused.message().split("try again in ").nth(1).unwrap();
    let wait: u64 = words.split(' ').next().unwrap().parse().unwrap();
    assert!((1..=1000).contains(&wait), "{refused}");
    assert!(refused.metadata().contains_key("request-id"), "{refused:?}");
}

#[tokio::test]
async fn so_many_streams_of_one_client_and_no_more() {
    let server = TestServer::start_with(&["--calls-at-once", "2"]).await;
    let mut api = Api::connect(&server).await;
    lab::create_task(&mut api).await;
    let mut held = Vec::new();
    for _ in 0..2 {
        // On a connection of its own, as the limit is the client's and not the connection's.
        let mut other = Api::connect(&server).await;
        let (say, said) = mpsc::channel::<SessionRequest>(1);
        held.push((say, other.policies.session(ReceiverStream::new(said)).await.unwrap()));
    }
    let refused = api.tasks.list_tasks(ListTasksRequest::default()).await.unwrap_err();
    assert_eq!(refused.code(), Code::ResourceExhausted, "{refused}");
    assert!(refused.message().contains("--calls-at-once"), "{refused}");
    let (say, answers) = held.pop().unwrap();
    drop(say);
    let mut answers = answers.into_inner();
    while let Some(Ok(_)) = answers.next().await {}
    drop(answers);
    // Its end is said before it is counted.
    for _ in 0..40 {
        match api.tasks.list_tasks(ListTasksRequest::default()).await {
            Ok(_) => return,
            Err(status) => assert_eq!(status.code(), Code::ResourceExhausted, "{status}"),
        }
    }
    panic!("the place of a stream that has ended stays taken");
}
