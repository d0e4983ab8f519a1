//! The address and the options of workers on a cluster: TLS, refused options.

use gleaner_client::UploadLabel;
use gleaner_proto::v1::*;

use crate::support::{
    lab::{self, RECORDINGS},
    secure::SecureServer,
    slurm::Cluster,
    wait::within,
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
    let request = SubmitJobRequest {
        task: lab::TASK.into(),
        spec: Some(JobSpec { spec: Some(lab::pretrain(2)) }),
        ..Default::default()
    };
    let job = client.jobs().submit_job(request).await.unwrap().into_inner().job.unwrap();
    let mut events = client.jobs().watch_job(WatchJobRequest { job_id: job.id }).await.unwrap().into_inner();
    let mut ended = Job::default();
    let watching = async {
        while let Some(event) = events.message().await.unwrap() {
            ended = event.job.unwrap();
        }
    };
    within("the job ends", watching).await;
    assert_eq!((ended.state(), ended.engine.as_str()), (JobState::Succeeded, "slurm"), "{}", ended.error);
}

/// Slurm sends SIGTERM, and the worker saves a checkpoint before it ends.
#[tokio::test]
async fn preempted_job_loses_no_step_and_no_attempt() {
    const STEPS: u64 = 60;
    let Some(cluster) = Cluster::start(1).await else { return };
    let flags = [cluster.flags(), vec!["--slurm-options".to_owned(), "--partition=low".to_owned()]].concat();
    let flags: Vec<&str> = flags.iter().map(String::as_str).collect();
    let (_server, mut api, _) = lab::with_episodes(&flags).await;
    let job = api.submit(lab::TASK, lab::pretrain(60)).await.unwrap();
    let first = api.watch_until(&job.id, |job| job.done >= 5).await;
    cluster.preempt().await;
    let ended = api.watch(&job.id).await;
    assert_eq!((ended.state(), ended.attempt), (JobState::Succeeded, 1), "{}", ended.error);
    assert_ne!(ended.engine_id, first.engine_id, "it was preempted");
    let steps: Vec<u64> = api.metric(&job.id, "loss").await.into_iter().map(|(step, _)| step).collect();
    assert_eq!(steps, (1..=STEPS).collect::<Vec<_>>(), "no step is lost or repeated");
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
