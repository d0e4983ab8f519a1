//! A connection that breaks after the server has accepted a request and before its response arrives.

use gleaner_proto::v1::*;
use tokio::{
    io::{copy, copy_bidirectional},
    net::{TcpListener, TcpStream},
};

use crate::support::{api::Api, command, lab, server::TestServer, wait::until};

/// Forwards connections to a server. The first receives no response, and breaks once the server has a job.
async fn relay(listener: TcpListener, server: &TestServer, mut api: Api) {
    let (mut client, _) = listener.accept().await.unwrap();
    let mut upstream = TcpStream::connect(server.address()).await.unwrap();
    let (mut requests, _) = client.split();
    tokio::select! {
        _ = copy(&mut requests, &mut upstream) => panic!("the command ended before the server had a job"),
        () = until("the server has a job", async || (!jobs(&mut api).await.is_empty()).then_some(())) => {}
    }
    drop((client, upstream));
    loop {
        let (mut client, _) = listener.accept().await.unwrap();
        let mut upstream = TcpStream::connect(server.address()).await.unwrap();
        // The command may end in the middle of a connection.
        let _ = copy_bidirectional(&mut client, &mut upstream).await;
    }
}

async fn jobs(api: &mut Api) -> Vec<Job> {
    api.jobs.list_jobs(ListJobsRequest::default()).await.unwrap().into_inner().jobs
}

#[tokio::test]
async fn submission_of_the_command_line_whose_response_is_lost_is_one_job() {
    let (server, mut api, _) = lab::with_episodes(&["--workers", "0"]).await;
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let url = format!("http://{}", listener.local_addr().unwrap());
    let submit = ["pretrain", "--task", lab::TASK, "--steps", "4"];
    let submitted = tokio::select! {
        () = relay(listener, &server, api.clone()) => unreachable!("the relay has no end"),
        submitted = command::json(&url, &submit) => submitted,
    };
    let [job] = jobs(&mut api).await.try_into().expect("one job");
    assert_eq!(submitted["id"], job.id);
    assert_eq!(submitted["key"], job.key);

    // Each call has a key of its own, so that the same command queues another job.
    let again = command::json(server.url(), &submit).await;
    assert_ne!(again["key"], submitted["key"]);
    assert_eq!(jobs(&mut api).await.len(), 2);
    let named = [&submit[..], &["--key", &job.key]].concat();
    assert_eq!(command::json(server.url(), &named).await["id"], job.id);
}
