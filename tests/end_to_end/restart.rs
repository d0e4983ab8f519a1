//! Restarts after a kill or a stop: acknowledged changes exist, uploads resume, jobs end with the same result.

use gleaner_proto::v1::*;
use tonic::Code;

use crate::support::{
    api::Api,
    command,
    lab::{self, RECORDINGS},
    server::{TestServer, serve},
};

#[tokio::test]
async fn acknowledged_changes_survive_a_kill() {
    let (mut server, mut api, episodes) = lab::with_episodes(&["--workers", "0"]).await;
    let job = api.submit(lab::TASK, lab::pretrain(4)).await.unwrap();
    server.kill().await;
    server.start_again().await;

    let mut api = Api::connect(&server).await;
    assert_eq!(api.episodes().await, episodes);
    let request = GetJobRequest { job_id: job.id.clone() };
    assert_eq!(api.jobs.get_job(request).await.unwrap().into_inner().job.unwrap(), job);
    assert!(api.download(&episodes[0].id).await == RECORDINGS[0].bytes, "the recording differs");
}

/// A second submission with the same key returns the existing job.
#[tokio::test]
async fn job_key_is_one_job_across_a_restart() {
    let (mut server, mut api, _) = lab::with_episodes(&["--workers", "0"]).await;
    let request = |steps| SubmitJobRequest {
        task: lab::TASK.into(),
        spec: Some(JobSpec { spec: Some(lab::pretrain(steps)) }),
        key: "pretrain 4f1c".into(),
        ..SubmitJobRequest::default()
    };
    let job = api.jobs.submit_job(request(4)).await.unwrap().into_inner().job.unwrap();
    assert_eq!(job.key, "pretrain 4f1c");
    server.kill().await;
    server.start_again().await;

    let mut api = Api::connect(&server).await;
    assert_eq!(api.jobs.submit_job(request(4)).await.unwrap().into_inner().job.unwrap(), job);
    let other = api.jobs.submit_job(request(5)).await.unwrap_err();
    assert!(other.code() == Code::AlreadyExists && other.message().contains(&job.id), "{other}");
    api.jobs.cancel_job(CancelJobRequest { job_id: job.id.clone() }).await.unwrap();
    let again = api.jobs.submit_job(request(5)).await.unwrap().into_inner().job.unwrap();
    assert_ne!(again.id, job.id, "a cancelled job holds no key");
}

/// The response of the first call may have been lost with the server.
#[tokio::test]
async fn pipeline_key_is_one_chain_across_a_restart() {
    let (mut server, mut api, _) = lab::with_episodes(&["--workers", "0"]).await;
    let request = |beta| SubmitPipelineRequest {
        task: lab::TASK.into(),
        pipeline: Some(PipelineSpec {
            pretrain: Some(PretrainSpec::default()),
            score: true,
            beta: Some(beta),
            ..PipelineSpec::default()
        }),
        key: "nightly 4f1c".into(),
        ..SubmitPipelineRequest::default()
    };
    let first = api.jobs.submit_pipeline(request(0.5)).await.unwrap().into_inner();
    assert_eq!(first.jobs.iter().map(|job| job.key.as_str()).collect::<Vec<_>>(), ["", "nightly 4f1c"]);
    server.kill().await;
    server.start_again().await;

    let mut api = Api::connect(&server).await;
    assert_eq!(api.jobs.submit_pipeline(request(0.5)).await.unwrap().into_inner(), first);
    let other = api.jobs.submit_pipeline(request(0.9)).await.unwrap_err();
    assert!(other.code() == Code::AlreadyExists && other.message().contains(&first.jobs[1].id), "{other}");
    api.jobs.cancel_job(CancelJobRequest { job_id: first.jobs[0].id.clone() }).await.unwrap();
    let again = api.jobs.submit_pipeline(request(0.9)).await.unwrap().into_inner();
    assert_ne!(again.dataset_id, first.dataset_id, "a cancelled chain holds no key");
    assert_eq!(api.jobs.list_jobs(ListJobsRequest::default()).await.unwrap().into_inner().jobs.len(), 4);
}

#[tokio::test]
async fn upload_resumes_after_a_kill() {
    let (mut server, mut api) = lab::idle().await;
    let recording = &RECORDINGS[0];
    let half = recording.bytes.len() / 2;
    let upload = lab::start(&mut api, lab::TASK, recording).await.unwrap().upload_id;
    let committed = lab::write(&mut api, &upload, 0, recording.bytes.slice(..half)).await.unwrap();
    assert_eq!(committed, u64::try_from(half).unwrap());

    let unfinished = lab::finish(&mut api, &upload).await.unwrap_err();
    assert_eq!(unfinished.code(), Code::FailedPrecondition, "{unfinished}");
    server.kill().await;
    server.start_again().await;

    let mut api = Api::connect(&server).await;
    assert_eq!(api.committed_size(&upload).await.unwrap(), committed);
    let gap = lab::write(&mut api, &upload, committed + 1, recording.bytes.slice(half + 1..)).await.unwrap_err();
    assert_eq!(gap.code(), Code::InvalidArgument, "{gap}");
    lab::write(&mut api, &upload, committed, recording.bytes.slice(half..)).await.unwrap();
    assert!(lab::finish(&mut api, &upload).await.unwrap().steps > 0);
}

/// The worker and then the server are killed during pretraining; losses and scores equal those of an uninterrupted run, bit
/// for bit.
#[tokio::test]
async fn killed_job_equals_an_uninterrupted_one() {
    const STEPS: u32 = 40;
    let (mut server, mut api, episodes) = lab::with_episodes(&[]).await;

    let uninterrupted = api.succeed(lab::TASK, lab::pretrain(STEPS)).await;

    let killed = api.submit(lab::TASK, lab::pretrain(STEPS)).await.unwrap();
    api.watch_until(&killed.id, |job| job.done >= 7).await;
    server.kill_workers();
    let second = api.watch_until(&killed.id, |job| job.attempt == 2 && job.done >= 13).await;
    assert!(second.done < u64::from(STEPS), "the test needs a job that is still running");
    server.kill().await;
    server.start_again().await;

    let mut api = Api::connect(&server).await;
    let ended = api.watch(&killed.id).await;
    assert_eq!(ended.state(), JobState::Succeeded, "{}", ended.error);
    let losses = api.metric(&uninterrupted.id, "loss").await;
    assert_eq!(last_of_each_step(api.metric(&killed.id, "loss").await), losses);

    let expected_run = api.succeed(lab::TASK, lab::score(&uninterrupted.result_id)).await.result_id;
    let killed_run = api.succeed(lab::TASK, lab::score(&killed.result_id)).await.result_id;
    for episode in &episodes {
        let expected = api.episode_scores(&expected_run, &episode.id).await;
        assert_eq!(api.episode_scores(&killed_run, &episode.id).await, expected);
    }
}

/// Steps after the last checkpoint run and are reported again; the last report counts.
fn last_of_each_step(values: Vec<(u64, f64)>) -> Vec<(u64, f64)> {
    let by_step: std::collections::BTreeMap<u64, f64> = values.into_iter().collect();
    by_step.into_iter().collect()
}

#[tokio::test]
async fn cancelling_a_job_cancels_its_dependents() {
    let (_server, mut api, _) = lab::with_episodes(&[]).await;
    let pretrain = api.submit(lab::TASK, lab::pretrain(100_000)).await.unwrap();
    let score = api.submit(lab::TASK, lab::score(&pretrain.result_id)).await.unwrap();
    assert_eq!(score.needs, std::slice::from_ref(&pretrain.id));
    api.watch_until(&pretrain.id, |job| job.done >= 1).await;
    api.jobs.cancel_job(CancelJobRequest { job_id: pretrain.id.clone() }).await.unwrap();
    assert_eq!(api.watch(&pretrain.id).await.state(), JobState::Cancelled);
    assert_eq!(api.watch(&score.id).await.state(), JobState::Cancelled);

    let again = api.jobs.cancel_job(CancelJobRequest { job_id: pretrain.id }).await.unwrap_err();
    assert_eq!(again.code(), Code::FailedPrecondition, "{again}");
}

#[tokio::test]
async fn stopped_job_resumes_without_repeating_a_step() {
    let (mut server, mut api, _) = lab::with_episodes(&[]).await;
    let job = api.submit(lab::TASK, lab::pretrain(30)).await.unwrap();
    api.watch_until(&job.id, |job| job.done >= 6).await;
    assert!(server.stop().await, "a stop on request is a success");
    server.start_again().await;

    let mut api = Api::connect(&server).await;
    let ended = api.watch(&job.id).await;
    assert_eq!((ended.state(), ended.attempt), (JobState::Succeeded, 1), "a stop is not an attempt");
    let steps: Vec<u64> = api.metric(&job.id, "loss").await.into_iter().map(|(step, _)| step).collect();
    assert_eq!(steps, (1..=30).collect::<Vec<_>>(), "no step is lost or repeated");
}

/// Two servers on one data folder would run the same jobs.
#[tokio::test]
async fn second_server_on_a_data_folder_is_rejected() {
    let server = TestServer::start_with(&["--workers", "0"]).await;
    let mut second = serve(server.data_dir(), &[""; 0], "127.0.0.1:0");
    let output = command::run(&mut second).await;
    let text = output.text();
    assert!(!output.success && text.contains(&server.data_dir().display().to_string()), "{text}");
    assert!(!text.contains("listening"), "{text}");
    // The first server continues.
    Api::connect(&server).await.jobs.list_jobs(ListJobsRequest::default()).await.unwrap();
}
