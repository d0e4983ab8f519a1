//! Where workers call: their service is nowhere else, and nothing is read of who has no job's token.

use futures::stream;
use gleaner_client::UploadLabel;
use gleaner_proto::{Rpc, v1::*};
use tonic::{Code, transport::Channel};

use super::{PATIENCE, guarded::Guarded, lab_task, raw};
use crate::{
    lab::{self, RECORDINGS},
    server::{TestServer, ports},
};

/// A request that is never sent whole.
#[tokio::test]
async fn a_token_is_looked_at_before_anything_is_read() {
    let server = TestServer::start_with(&["--workers", "0"]).await;
    let channel = Channel::from_shared(server.workers_url()).unwrap().connect().await.unwrap();
    for rpc in Rpc::ALL.iter().filter(|rpc| rpc.path().contains(".WorkerService/")) {
        for token in [None, Some("job_01ARZ3NDEKTSV4RRFFQ69G5FAV.00")] {
            let code = raw::call_with(&channel, rpc.path(), token, stream::pending()).await;
            assert_eq!(code, Code::Unauthenticated, "{}", rpc.path());
        }
    }
    let other = raw::call(&channel, Rpc::TaskServiceListTasks.path(), None, Vec::new()).await;
    assert_eq!(other, Code::Unimplemented, "nothing else is served there");
}

#[tokio::test]
async fn a_token_of_a_person_is_none_of_a_job() {
    let server = Guarded::start(&["--workers", "0"], &[]).await;
    let admin = server.token("admin", &[]).await;
    let path = Rpc::WorkerServiceGetAssignment.path();
    assert_eq!(raw::call(&raw::connect(&server).await, path, Some(&admin), Vec::new()).await, Code::Unimplemented);
    let public: u16 = server.url.rsplit(':').next().unwrap().parse().unwrap();
    let port = ports(server.child.id().unwrap()).into_iter().find(|port| *port != public).unwrap();
    let channel = Channel::from_shared(format!("http://127.0.0.1:{port}")).unwrap().connect().await.unwrap();
    assert_eq!(raw::call(&channel, path, Some(&admin), Vec::new()).await, Code::Unauthenticated);
}

/// What a job's process is given: its own token and what any program needs. No secret of the server's.
const GIVEN: [&str; 13] = [
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
async fn a_server_that_encrypts_runs_jobs_and_its_workers_know_little() {
    let server =
        Guarded::start(&[], &[("AWS_SECRET_ACCESS_KEY", "the crown jewels"), ("GLEANER_TOKEN", "another")]).await;
    let client = server.client(Some(&server.token("trainer", &[]).await)).await;
    lab_task(&client).await;
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
            seen.extend(environments(server.child.id().unwrap()));
            if gleaner_client::has_ended(job.state()) {
                return job;
            }
        }
    };
    let ended = tokio::time::timeout(PATIENCE, watching).await.unwrap();
    assert_eq!(ended.state(), JobState::Succeeded, "{}", ended.error);
    assert!(!seen.is_empty(), "no worker was seen");
    for environment in &seen {
        for variable in environment.split('\0').filter(|variable| !variable.is_empty()) {
            let name = variable.split('=').next().unwrap();
            assert!(GIVEN.contains(&name), "a worker was given {name}");
        }
    }
    let tokens = seen.iter().map(|environment| {
        let token = environment.split('\0').find_map(|variable| variable.strip_prefix("GLEANER_JOB_TOKEN=")).unwrap();
        // Its other half is the job's id, which is no secret.
        token.split_once('.').unwrap().1
    });
    server.tells_nobody(tokens);
}

/// The environments of the workers that a server runs now.
fn environments(server: u32) -> Vec<String> {
    let mut found = Vec::new();
    for task in std::fs::read_dir(format!("/proc/{server}/task")).unwrap() {
        let Ok(children) = std::fs::read_to_string(task.unwrap().path().join("children")) else { continue };
        for pid in children.split_whitespace() {
            let command = std::fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
            if command.split(|&byte| byte == 0).any(|word| word.ends_with(b"gleaner-worker-under-test")) {
                found.extend(std::fs::read_to_string(format!("/proc/{pid}/environ")).ok());
            }
        }
    }
    found.retain(|environment| environment.contains("GLEANER_JOB_TOKEN"));
    found
}
