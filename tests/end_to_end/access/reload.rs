//! SIGHUP reloads the certificate, and has no effect on a server without one.

use gleaner_proto::v1::ListTasksRequest;

use super::list;
use crate::support::{
    lab,
    process::{Signal, signal},
    secure::SecureServer,
    wait::until,
};

#[tokio::test]
async fn sighup_reloads_the_certificate() {
    let mut server = SecureServer::start(&["--workers", "0"], &[]).await;
    let viewer = server.token("viewer", &[]).await;
    let open = server.client(Some(&viewer)).await;
    // The files are unchanged.
    server.hang_up();
    until("the certificate is reloaded", async || {
        list(&open).await;
        server.log().contains("the certificate was read again").then_some(())
    })
    .await;

    server.renew();
    server.hang_up();
    until("the new certificate is served", async || server.connect(Some(&viewer)).await.ok()).await;
    assert_eq!(list(&open).await, tonic::Code::Ok, "the open connection continues");
}

#[tokio::test]
async fn sighup_does_not_end_a_server_without_a_certificate() {
    let (mut server, mut api) = lab::idle().await;
    signal(server.pid(), Signal::HUP);
    api.tasks.list_tasks(ListTasksRequest::default()).await.unwrap();
    assert!(server.stop().await, "SIGHUP ended the server");
}
