//! A peer that reads its socket but grants no window for the response it requested.

use bytes::Bytes;
use gleaner_proto::{Rpc, v1::*};
use h2::client::{self, SendRequest};
use http::{Request, Response};
use prost::Message as _;
use tokio::{net::TcpStream, task::JoinHandle, time::timeout};

use super::BOUND;
use crate::support::{
    api::Api,
    lab::{self, RECORDINGS},
    server::TestServer,
};

type Ended = JoinHandle<Result<(), h2::Error>>;

/// Opens a connection with this initial window for responses, in bytes.
async fn connect(url: &str, window: u32) -> (SendRequest<Bytes>, Ended) {
    let stream = TcpStream::connect(url.strip_prefix("http://").unwrap()).await.unwrap();
    let (calls, connection) = client::Builder::new().initial_window_size(window).handshake(stream).await.unwrap();
    (calls, tokio::spawn(connection))
}

async fn call(calls: &mut SendRequest<Bytes>, url: &str, rpc: Rpc, message: Vec<u8>) -> Response<h2::RecvStream> {
    let request = Request::post(format!("{url}{}", rpc.path()))
        .header("content-type", "application/grpc")
        .header("te", "trailers")
        .body(())
        .unwrap();
    let (response, mut body) = calls.send_request(request, false).unwrap();
    let length = u32::try_from(message.len()).unwrap().to_be_bytes();
    body.send_data([&[0], length.as_slice(), &message].concat().into(), true).unwrap();
    response.await.unwrap()
}

/// A response that is read in small parts is complete; on a busy machine, the reader may pause for longer than the limit
/// of the second server.
#[tokio::test]
async fn connection_whose_response_is_not_read_is_closed() {
    let (mut server, mut api) = lab::with_task(&["--workers", "0"]).await;
    let episode = lab::push(&mut api, lab::TASK, &RECORDINGS[0]).await.unwrap();
    let download = DownloadEpisodeRequest { episode_id: episode.id, accept_url: false }.encode_to_vec();
    let (mut calls, _ended) = connect(server.url(), 1 << 10).await;
    let mut body =
        call(&mut calls, server.url(), Rpc::EpisodeServiceDownloadEpisode, download.clone()).await.into_body();
    let mut received = 0;
    while let Some(data) = body.data().await {
        let data = data.unwrap();
        received += data.len();
        body.flow_control().release_capacity(data.len()).unwrap();
    }
    assert!(received > RECORDINGS[0].bytes.len());
    assert!(server.stop().await);

    let server = TestServer::start_over(server.data_dir(), &["--write-timeout", "1", "--workers", "0"]).await;
    let mut api = Api::connect(&server).await;
    api.tasks.list_tasks(ListTasksRequest::default()).await.unwrap();
    let unread = async |rpc, message| {
        let (mut calls, ended) = connect(server.url(), 0).await;
        let _held = call(&mut calls, server.url(), rpc, message).await;
        // A reset is an end too.
        let _ = timeout(BOUND, ended).await.expect("the connection ends").unwrap();
    };
    tokio::join!(unread(Rpc::TaskServiceListTasks, Vec::new()), unread(Rpc::EpisodeServiceDownloadEpisode, download));
    // An idle connection stays open.
    api.tasks.list_tasks(ListTasksRequest::default()).await.unwrap();
}
