//! Stopping: health turns first, clients are told, and it ends in time whatever they do.

use std::time::{Duration, Instant};

use futures::{StreamExt as _, stream};
use gleaner_proto::v1::*;
use tokio::{io::AsyncWriteExt as _, net::TcpStream, sync::oneshot, time::timeout};
use tonic::{Code, transport::Channel};
use tonic_health::pb::{HealthCheckRequest, health_check_response::ServingStatus, health_client::HealthClient};
use tonic_reflection::pb::{
    v1::server_reflection_client::ServerReflectionClient,
    v1alpha::server_reflection_client::ServerReflectionClient as ServerReflectionAlphaClient,
};

use crate::{
    api::Api,
    lab::{self, RECORDINGS},
    server::TestServer,
    skipped::skipped,
};

/// No event in these tests takes longer.
const PATIENCE: Duration = Duration::from_secs(60);
/// What the server may take above its drain.
const ENDING: Duration = Duration::from_secs(10);

#[tokio::test]
async fn each_service_says_that_it_stops() {
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
    // Reflection is asked and stays open too.
    let mut reflected = ServerReflectionClient::new(channel.clone());
    let mut reflected = reflected.server_reflection_info(stream::pending()).await.unwrap().into_inner();
    let mut reflected_alpha = ServerReflectionAlphaClient::new(channel.clone());
    let mut reflected_alpha = reflected_alpha.server_reflection_info(stream::pending()).await.unwrap().into_inner();
    let told = async {
        for (service, watch) in &mut watches {
            assert_eq!(watch.next().await.unwrap().unwrap().status(), ServingStatus::NotServing, "{service}");
            assert_eq!(watch.next().await.unwrap().unwrap_err().code(), Code::Unavailable, "{service}");
        }
        assert!(!matches!(reflected.message().await, Ok(Some(_))));
        assert!(!matches!(reflected_alpha.message().await, Ok(Some(_))));
    };
    // Nobody has gone, and it waits for nobody.
    let (stopped, ()) = timeout(PATIENCE, async { tokio::join!(server.stop(), told) }).await.unwrap();
    assert!(stopped);
}

/// The first process of a container, which the system lets nobody kill from within.
#[tokio::test]
async fn a_second_signal_ends_it_also_as_the_first_process() {
    let own = tempfile::tempdir().unwrap();
    let Some(mut server) = TestServer::start_as_init(own.path(), &["--drain-seconds", "3600"]).await else {
        skipped("this machine lets nobody begin a namespace of processes");
        return;
    };
    let mut api = Api::connect(&server).await;
    lab::create_task(&mut api).await;
    // A call that holds the drain up.
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
    server.terminate();
    assert_eq!(watch.next().await.unwrap().unwrap().status(), ServingStatus::NotServing);
    server.terminate();
    let ended = timeout(PATIENCE, server.ended()).await.expect("it goes on");
    assert!(!ended, "it was killed, not drained");
    upload.abort();
}

/// Clients that hold calls open, never read, and flood.
#[tokio::test]
async fn it_ends_whatever_clients_do() {
    let mut server = TestServer::start_with(&["--drain-seconds", "1"]).await;
    let mut api = Api::connect(&server).await;
    lab::create_task(&mut api).await;
    let upload_id = lab::start(&mut api, lab::TASK, &RECORDINGS[0]).await.unwrap().upload_id;
    let address = server.url().strip_prefix("http://").unwrap().to_owned();
    let silent = TcpStream::connect(&address).await.unwrap();
    let mut garbage = TcpStream::connect(&address).await.unwrap();
    let mut robot = Api::connect(&server).await;
    let held = robot.policies.session(stream::pending::<SessionRequest>()).await.unwrap();
    let first = WriteUploadRequest { upload_id, offset: 0, data: RECORDINGS[0].bytes.slice(..100) };
    let mut uploader = Api::connect(&server).await;
    let (begins, begun) = oneshot::channel();
    let upload = tokio::spawn(async move {
        let first = stream::once(async move {
            begins.send(()).unwrap();
            first
        });
        uploader.episodes.write_upload(first.chain(stream::pending())).await
    });
    begun.await.unwrap();
    let mut flooder = Api::connect(&server).await;
    let flood = tokio::spawn(async move {
        while flooder.tasks.list_tasks(ListTasksRequest::default()).await.is_ok() {}
        while garbage.write_all(&[7; 1024]).await.is_ok() {}
    });
    let begun = Instant::now();
    assert!(server.stop().await);
    assert!(begun.elapsed() < Duration::from_secs(1) + ENDING, "{:?}", begun.elapsed());
    assert!(upload.await.unwrap().is_err());
    flood.await.unwrap();
    drop((silent, held));
}
