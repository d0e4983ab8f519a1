//! The worker service: it has a listener of its own, and rejects callers without the token of a job unread.

use futures::stream;
use gleaner_client::UploadLabel;
use gleaner_proto::{Rpc, v1::*};
use tonic::{Code, transport::Channel};

use super::create_task;
use crate::support::{
    lab::{self, RECORDINGS},
    process::{ports, workers},
    rpc,
    secure::SecureServer,
    server::TestServer,
    wait::within,
};

/// The request is never complete.
#[tokio::test]
async fn worker_token_is_checked_before_the_request_is_read() {
    let server = TestServer::start_with(&["--workers", "0"]).await;
    let channel = Channel::from_shared(server.workers_url()).unwrap().connect().await.unwrap();
    for rpc in Rpc::ALL.iter().filter(|rpc| rpc.path().contains(".WorkerService/")) {
        for token in [None, Some("job_01ARZ3NDEKTSV4RRFFQ69G5FAV.00")] {
            let code = rpc::call_with(&channel, rpc.path(), token, stream::pending()).await;
            assert_eq!(code, Code::Unauthenticated, "{}", rpc.path());
        }
    }
    let other = rpc::call(&channel, Rpc::TaskServiceListTasks.path(), None, Vec::new()).await;
    assert_eq!(other, Code::Unimplemented, "another service is served there");
}

#[tokio::test]
async fn user_token_is_rejected_by_the_worker_service() {
    let server = SecureServer::start(&["--workers", "0"], &[]).await;
    let admin = server.token("admin", &[]).await;
    let path = Rpc::WorkerServiceGetAssignment.path();
    assert_eq!(rpc::call(&rpc::connect(&server).await, path, Some(&admin), Vec::new()).await, Code::Unimplemented);
    let public: u16 = server.running.url.rsplit(':').next().unwrap().parse().unwrap();
    let port = ports(server.running.pid()).into_iter().find(|port| *port != public).unwrap();
    let channel = Channel::from_shared(format!("http://127.0.0.1:{port}")).unwrap().connect().await.unwrap();
    assert_eq!(rpc::call(&channel, path, Some(&admin), Vec::new()).await, Code::Unauthenticated);
}

/// The environment of a worker: the token of its job and the variables that any program needs.
const ALLOWED: [&str; 13] = [
    "PATH",
    "HOME",
    "TMPDIR",
    "TZ",
    "LANG",
    "LD_LIBRARY_PATH",
    "CUDA_VISIBLE_DEVICES",
    "MKL_NUM_THREADS",
    "RUST_BACKTRACE",
    "GLEANER_LOG",
    "GLEANER_LOG_JSON",
    "OMP_WAIT_POLICY",
    "GLEANER_JOB_TOKEN",
];

#[tokio::test]
async fn workers_of_a_server_with_tls_receive_no_secrets() {
    let server =
        SecureServer::start(&[], &[("AWS_SECRET_ACCESS_KEY", "the crown jewels"), ("GLEANER_TOKEN", "another")]).await;
    let client = server.client(Some(&server.token("trainer", &[]).await)).await;
    create_task(&client).await;
    for recording in [&RECORDINGS[0], &RECORDINGS[6]] {
        let file = tempfile::Builder::new().suffix(".mcap").tempfile().unwrap();
        std::fs::write(file.path(), &recording.bytes).unwrap();
        let label = UploadLabel { outcome: recording.outcome, cohort: String::new(), author: String::new() };
        client.upload(lab::TASK, file.path(), &label, |_| ()).await.unwrap();
    }
    let request = SubmitJobRequest {
        task: lab::TASK.into(),
        spec: Some(JobSpec { spec: Some(lab::pretrain(2)) }),
        ..Default::default()
    };
    let job = client.jobs().submit_job(request).await.unwrap().into_inner().job.unwrap();
    let mut seen = Vec::new();
    let watching = async {
        let request = WatchJobRequest { job_id: job.id.clone() };
        let mut events = client.jobs().watch_job(request).await.unwrap().into_inner();
        loop {
            let job = events.message().await.unwrap().unwrap().job.unwrap();
            seen.extend(environments(server.running.pid()));
            if gleaner_client::has_ended(job.state()) {
                return job;
            }
        }
    };
    let ended = within("the job ends", watching).await;
    assert_eq!(ended.state(), JobState::Succeeded, "{}", ended.error);
    assert!(!seen.is_empty(), "no worker was seen");
    for environment in &seen {
        for variable in environment.split('\0').filter(|variable| !variable.is_empty()) {
            let name = variable.split('=').next().unwrap();
            assert!(ALLOWED.contains(&name), "a worker received {name}");
        }
    }
    let tokens = seen.iter().map(|environment| {
        let token = environment.split('\0').find_map(|variable| variable.strip_prefix("GLEANER_JOB_TOKEN=")).unwrap();
        // The first half is the id of the job, which is not secret.
        token.split_once('.').unwrap().1
    });
    server.expect_no_secret(tokens);
}

/// The environments of a server's workers.
fn environments(server: u32) -> Vec<String> {
    let running = workers(server).into_iter();
    let found = running.filter_map(|pid| std::fs::read_to_string(format!("/proc/{pid}/environ")).ok());
    found.filter(|environment| environment.contains("GLEANER_JOB_TOKEN")).collect()
}
