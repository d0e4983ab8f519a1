//! A peer that reads its socket and takes nothing of what it has asked for.

use bytes::Bytes;
use gleaner_proto::{Rpc, v1::*};
use h2::client::{self, SendRequest};
use http::{Request, Response};
use prost::Message as _;
use tokio::{net::TcpStream, task::JoinHandle, time::timeout};

use super::PATIENCE;
use crate::{
    api::Api,
    lab::{self, RECORDINGS},
    server::TestServer,
};

type Ended = JoinHandle<Result<(), h2::Error>>;

/// A connection on which an answer may have so many bytes until more are asked for.
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
    let (answer, mut say) = calls.send_request(request, false).unwrap();
    let length = u32::try_from(message.len()).unwrap().to_be_bytes();
    say.send_data([&[0], length.as_slice(), &message].concat().into(), true).unwrap();
    answer.await.unwrap()
}

#[tokio::test]
async fn who_takes_nothing_of_an_answer_is_given_up_though_the_socket_is_read() {
    let server = TestServer::start_with(&["--write-timeout", "1", "--workers", "0"]).await;
    let mut api = Api::connect(&server).await;
    lab::create_task(&mut api).await;
    let episode = lab::push(&mut api, lab::TASK, &RECORDINGS[0]).await.unwrap();
    let download = DownloadEpisodeRequest { episode_id: episode.id }.encode_to_vec();
    for (rpc, message) in
        [(Rpc::TaskServiceListTasks, Vec::new()), (Rpc::EpisodeServiceDownloadEpisode, download.clone())]
    {
        let (mut calls, ended) = connect(server.url(), 0).await;
        let held = call(&mut calls, server.url(), rpc, message).await;
        // Thrown out or shut: either is an end.
        let _ = timeout(PATIENCE, ended).await.expect("the connection ends").unwrap();
        drop((held, calls));
    }
    // Who takes a little at a time, but takes it, gets all.
    let (mut calls, _ended) = connect(server.url(), 1 << 10).await;
    let mut body = call(&mut calls, server.url(), Rpc::EpisodeServiceDownloadEpisode, download).await.into_body();
    let mut taken = 0;
    while let Some(data) = body.data().await {
        let data = data.unwrap();
        taken += data.len();
        body.flow_control().release_capacity(data.len()).unwrap();
    }
    assert!(taken > RECORDINGS[0].bytes.len());
    // Who is silent because nothing is said is not at fault.
    api.tasks.list_tasks(ListTasksRequest::default()).await.unwrap();
}
