//! Shutdown: the health turns first, open streams end with UNAVAILABLE, and the drain is bounded.

use std::time::{Duration, Instant};

use futures::{StreamExt as _, stream};
use gleaner_proto::v1::*;
use tokio::{io::AsyncWriteExt as _, net::TcpStream, sync::oneshot};
use tonic::{Code, transport::Channel};
use tonic_health::pb::{HealthCheckRequest, health_check_response::ServingStatus, health_client::HealthClient};
use tonic_reflection::pb::{
    v1::server_reflection_client::ServerReflectionClient,
    v1alpha::server_reflection_client::ServerReflectionClient as ServerReflectionAlphaClient,
};

use crate::support::{
    api::Api,
    lab::{self, RECORDINGS},
    server::TestServer,
    skipped::skipped,
    wait::within,
};

/// The longest time of a shutdown beyond its drain.
const MARGIN: Duration = Duration::from_secs(10);

#[tokio::test]
async fn health_of_each_service_turns_not_serving_before_the_drain() {
    let mut server = TestServer::start_with(&["--drain-seconds", "3600"]).await;
    let channel = Channel::from_shared(server.url().to_owned()).unwrap().connect().await.unwrap();
    let mut watches = Vec::new();
    for service in ["", "gleaner.v1.TaskService", "gleaner.v1.PolicyService", "inference.GRPCInferenceService"] {
        let request = HealthCheckRequest { service: service.to_owned() };
        let mut watch = HealthClient::new(channel.clone()).watch(request).await.unwrap().into_inner();
        let first = watch.next().await.unwrap().unwrap();
        assert_eq!(first.status(), ServingStatus::Serving, "{service}");
        watches.push((service, watch));
    }
    // The streams of reflection are open too.
    let mut reflected = ServerReflectionClient::new(channel.clone());
    let mut reflected = reflected.server_reflection_info(stream::pending()).await.unwrap().into_inner();
    let mut reflected_alpha = ServerReflectionAlphaClient::new(channel.clone());
    let mut reflected_alpha = reflected_alpha.server_reflection_info(stream::pending()).await.unwrap().into_inner();
    let ended = async {
        for (service, watch) in &mut watches {
            assert_eq!(watch.next().await.unwrap().unwrap().status(), ServingStatus::NotServing, "{service}");
            assert_eq!(watch.next().await.unwrap().unwrap_err().code(), Code::Unavailable, "{service}");
        }
        assert!(!matches!(reflected.message().await, Ok(Some(_))));
        assert!(!matches!(reflected_alpha.message().await, Ok(Some(_))));
    };
    // Every client is still connected, and none delays the end.
    let (stopped, ()) = within("the server stops", async { tokio::join!(server.stop(), ended) }).await;
    assert!(stopped);
}

/// Process 1 of a container, which ignores signals that it does not handle.
#[tokio::test]
async fn second_signal_ends_a_server_that_is_process_1() {
    let own = tempfile::tempdir().unwrap();
    let Some(mut server) = TestServer::start_as_init(own.path(), &["--drain-seconds", "3600"]).await else {
        skipped("a namespace of processes cannot be created here");
        return;
    };
    let mut api = Api::connect(&server).await;
    lab::create_task(&mut api).await;
    // A call that delays the drain.
    let upload_id = lab::start(&mut api, lab::TASK, &RECORDINGS[0]).await.unwrap().upload_id;
    let held = WriteUploadRequest { upload_id, offset: 0, data: RECORDINGS[0].bytes.slice(..100) };
    let mut uploader = Api::connect(&server).await;
    let upload =
        tokio::spawn(
            async move { uploader.episodes.write_upload(stream::iter([held]).chain(stream::pending())).await },
        );
    let channel = Channel::from_shared(server.url().to_owned()).unwrap().connect().await.unwrap();
    let watch = HealthClient::new(channel).watch(HealthCheckRequest::default()).await.unwrap();
    let mut watch = watch.into_inner();
    watch.next().await.unwrap().unwrap();
    server.terminate_child();
    assert_eq!(watch.next().await.unwrap().unwrap().status(), ServingStatus::NotServing);
    server.terminate_child();
    let ended = within("the server ends", server.ended()).await;
    assert!(!ended, "the drain was cut short");
    upload.abort();
}

/// Clients that keep calls open, never read, or flood the server.
#[tokio::test]
async fn drain_ends_in_time_despite_open_calls_and_floods() {
    let (mut server, mut api) = lab::with_task(&["--drain-seconds", "1"]).await;
    let upload_id = lab::start(&mut api, lab::TASK, &RECORDINGS[0]).await.unwrap().upload_id;
    let address = server.address().to_owned();
    let silent = TcpStream::connect(&address).await.unwrap();
    let mut garbage = TcpStream::connect(&address).await.unwrap();
    let mut robot = Api::connect(&server).await;
    let held = robot.policies.session(stream::pending::<SessionRequest>()).await.unwrap();
    let first = WriteUploadRequest { upload_id, offset: 0, data: RECORDINGS[0].bytes.slice(..100) };
    let mut uploader = Api::connect(&server).await;
    let (start, started) = oneshot::channel();
    let upload = tokio::spawn(async move {
        let first = stream::once(async move {
            start.send(()).unwrap();
            first
        });
        uploader.episodes.write_upload(first.chain(stream::pending())).await
    });
    started.await.unwrap();
    let mut flooder = Api::connect(&server).await;
    let flood = tokio::spawn(async move {
        while flooder.tasks.list_tasks(ListTasksRequest::default()).await.is_ok() {}
        while garbage.write_all(&[7; 1024]).await.is_ok() {}
    });
    let begun = Instant::now();
    assert!(server.stop().await);
    assert!(begun.elapsed() < Duration::from_secs(1) + MARGIN, "{:?}", begun.elapsed());
    assert!(upload.await.unwrap().is_err());
    flood.await.unwrap();
    drop((silent, held));
}
