//! The address, the files and the options of workers on a cluster: TLS, a bucket, refused options.

use std::path::{Path, PathBuf};

use gleaner_bucket::testing::TestStore;
use gleaner_client::UploadLabel;
use gleaner_proto::v1::*;

use super::{ENDLESS, resumes_whole};
use crate::support::{
    api::Api,
    blob_store, files,
    lab::{self, RECORDINGS},
    secure::SecureServer,
    server::TestServer,
    slurm::Cluster,
};

#[tokio::test]
async fn workers_on_a_cluster_call_by_tls_with_the_authority_of_the_server() {
    let Some(cluster) = Cluster::start(1).await else { return };
    let folder = tempfile::tempdir().unwrap();
    let authority = folder.path().join("ca").display().to_string();
    let flags = [cluster.flags(), vec!["--worker-ca".to_owned(), authority]].concat();
    let flags: Vec<&str> = flags.iter().map(String::as_str).collect();
    let server = SecureServer::start_in(folder, &flags, &[]).await;
    let client = server.client(Some(&server.token("trainer", &[]).await)).await;
    client.tasks().create_task(CreateTaskRequest { spec: Some(lab::spec_message()) }).await.unwrap();
    for recording in [&RECORDINGS[0], &RECORDINGS[6]] {
        let file = tempfile::Builder::new().suffix(".mcap").tempfile().unwrap();
        std::fs::write(file.path(), &recording.bytes).unwrap();
        let label = UploadLabel { outcome: recording.outcome, cohort: String::new(), author: String::new() };
        client.upload(lab::TASK, file.path(), &label, |_| ()).await.unwrap();
    }
    assert_eq!(super::pretrain(&client).await.len(), 2);
}

/// The shared folder has no recording, no steps and no encoder until workers fetch or make them, without credentials, and
/// recordings and steps are on the disk of the nodes.
#[tokio::test]
async fn jobs_on_nodes_read_and_write_a_bucket() {
    let Some(cluster) = Cluster::start(2).await else { return };
    let Some(store) = TestStore::start().unwrap() else { return };
    let folder = tempfile::tempdir().unwrap();
    let environment = folder.path().join("environment");
    let setup = format!("env >> '{}'", environment.display());
    let near = folder.path().join("near");
    let own = ["--slurm-setup", &setup, "--slurm-cache-dir", near.to_str().unwrap()].map(str::to_owned);
    let flags = [cluster.flags(), own.into()].concat();
    let mut server = blob_store::start(&store, "one", &flags.iter().map(String::as_str).collect::<Vec<_>>()).await;
    let mut api = Api::connect(&server).await;
    let episodes = lab::set_up(&mut api).await;
    blob_store::forget_copies(server.data_dir());
    let pretrain = api.succeed(lab::TASK, lab::pretrain(4)).await;
    blob_store::forget_copies(server.data_dir());
    let score = api.succeed(lab::TASK, lab::score(&pretrain.result_id)).await;
    let is_steps = |file: &PathBuf| file.extension().is_some_and(|kind| kind == "frames");
    let of_steps = |folder: &Path| files::files(folder).into_iter().filter(is_steps).count();
    assert_eq!(of_steps(&near), episodes.len(), "the nodes decoded them once, on their own disk");
    assert_eq!(of_steps(&server.data_dir().join("cache")), 0);
    assert_eq!((pretrain.engine.as_str(), score.engine.as_str()), ("slurm", "slurm"));
    assert!(server.stop().await);
    let environment = std::fs::read_to_string(environment).unwrap();
    assert!(environment.lines().any(|line| line.starts_with("GLEANER_JOB_TOKEN=")));
    assert!(!environment.contains("AWS_"), "a node received credentials");

    // The encoder of a node is in the bucket: another server's own worker scores by it, with the same bytes.
    blob_store::forget_copies(server.data_dir());
    let server = TestServer::start_over(server.data_dir(), &[]).await;
    let mut api = Api::connect(&server).await;
    let local = api.succeed(lab::TASK, lab::score(&pretrain.result_id)).await;
    assert_eq!(local.engine, "local");
    for episode in &episodes {
        let expected = api.episode_scores(&local.result_id, &episode.id).await;
        assert_eq!(api.episode_scores(&score.result_id, &episode.id).await, expected);
    }
    cluster.until_empty().await;
}

/// Slurm sends SIGTERM, and the worker saves a checkpoint before it ends. The job has more steps than the test lasts.
#[tokio::test]
async fn preempted_job_loses_no_step_and_no_attempt() {
    let Some(cluster) = Cluster::start(1).await else { return };
    let flags = [cluster.flags(), vec!["--slurm-options".to_owned(), "--partition=low".to_owned()]].concat();
    let flags: Vec<&str> = flags.iter().map(String::as_str).collect();
    let (_server, mut api, _) = lab::with_episodes(&flags).await;
    let id = api.submit(lab::TASK, lab::pretrain(ENDLESS)).await.unwrap().id;
    let first = api.watch_until(&id, |job| job.done >= 5 && !job.engine_id.is_empty()).await;
    cluster.preempt().await;
    resumes_whole(&cluster, &mut api, &first, "PREEMPTED").await;
}

/// The job stays in the queue with the reason, and the server serves.
#[tokio::test]
async fn unknown_partition_is_a_reason_for_waiting() {
    let Some(cluster) = Cluster::start(1).await else { return };
    let flags = [cluster.flags(), vec!["--slurm-pretrain-options".to_owned(), "--partition=nope".to_owned()]].concat();
    let flags: Vec<&str> = flags.iter().map(String::as_str).collect();
    let (_server, mut api, _) = lab::with_episodes(&flags).await;
    let job = api.submit(lab::TASK, lab::pretrain(2)).await.unwrap();
    // Before its attempt the job waits for a free worker.
    let waits = api.watch_until(&job.id, |job| job.waiting.contains("nope")).await;
    for part in ["invalid partition specified: nope", "--slurm-pretrain-options"] {
        assert!(waits.waiting.contains(part), "{}", waits.waiting);
    }
    api.jobs.cancel_job(CancelJobRequest { job_id: job.id.clone() }).await.unwrap();
    assert_eq!(api.watch(&job.id).await.state(), JobState::Cancelled);
    assert!(cluster.jobs().await.is_empty());
}

#[tokio::test]
async fn options_of_a_job_win_over_those_of_the_server() {
    let Some(cluster) = Cluster::start(2).await else { return };
    let flags = [cluster.flags(), vec!["--slurm-options".to_owned(), "--nodelist=node1".to_owned()]].concat();
    let flags: Vec<&str> = flags.iter().map(String::as_str).collect();
    let (_server, mut api, _) = lab::with_episodes(&flags).await;
    for (engine_options, node) in [("", "node1"), ("--nodelist=node2 -t 10", "node2")] {
        let request = SubmitJobRequest {
            task: lab::TASK.into(),
            spec: Some(JobSpec { spec: Some(lab::pretrain(2)) }),
            engine_options: engine_options.to_owned(),
            ..SubmitJobRequest::default()
        };
        let job = api.jobs.submit_job(request).await.unwrap().into_inner().job.unwrap();
        let ended = api.watch(&job.id).await;
        assert_eq!((ended.state(), ended.node.as_str()), (JobState::Succeeded, node), "{}", ended.error);
        assert_eq!(ended.engine_options, engine_options);
    }
}
