//! SIGHUP: the certificate is read again, and without one nothing happens.

use gleaner_proto::v1::ListTasksRequest;

use super::{PATIENCE, guarded::Guarded, list};
use crate::{api::Api, server::TestServer};

const READ_AGAIN: &str = "the certificate was read again";

#[tokio::test]
async fn at_a_hangup_the_certificate_is_read_again_and_a_renewed_one_is_served() {
    let mut server = Guarded::start(&["--workers", "0"], &[]).await;
    let viewer = server.token("viewer", &[]).await;
    let open = server.client(Some(&viewer)).await;
    // Not a file has changed.
    server.hang_up();
    let read = async {
        while !server.log().contains(READ_AGAIN) {
            list(&open).await;
        }
    };
    tokio::time::timeout(PATIENCE, read).await.unwrap();

    server.renew();
    server.hang_up();
    let renewed = async { while server.connect(Some(&viewer)).await.is_err() {} };
    tokio::time::timeout(PATIENCE, renewed).await.unwrap();
    assert_eq!(list(&open).await, tonic::Code::Ok, "who was there goes on");
}

#[tokio::test]
async fn a_server_without_a_certificate_outlives_a_hangup() {
    let mut server = TestServer::start_with(&["--workers", "0"]).await;
    let mut api = Api::connect(&server).await;
    let pid = rustix::process::Pid::from_raw(server.pid().try_into().unwrap()).unwrap();
    rustix::process::kill_process(pid, rustix::process::Signal::HUP).unwrap();
    api.tasks.list_tasks(ListTasksRequest::default()).await.unwrap();
    assert!(server.stop().await, "it was ended by the hangup");
}
