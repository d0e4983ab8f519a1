//! Crashes: what was acknowledged is there afterwards, and a killed job ends as if nothing had happened.

use gleaner_proto::v1::*;
use tonic::Code;

use crate::{
    api::Api,
    lab::{self, RECORDINGS},
    server::TestServer,
};

#[tokio::test]
async fn what_was_acknowledged_survives_a_kill() {
    let mut server = TestServer::start_with(&["--workers", "0"]).await;
    let mut api = Api::connect(&server).await;
    let episodes = lab::set_up(&mut api).await;
    let job = api.submit(lab::TASK, lab::pretrain(4)).await.unwrap();
    server.kill().await;
    server.start_again().await;

    let mut api = Api::connect(&server).await;
    let request = ListEpisodesRequest { task: lab::TASK.into(), ..ListEpisodesRequest::default() };
    let listed = api.episodes.list_episodes(request).await.unwrap().into_inner().episodes;
    assert_eq!(listed, episodes);
    let request = GetJobRequest { job_id: job.id.clone() };
    assert_eq!(api.jobs.get_job(request).await.unwrap().into_inner().job.unwrap(), job);
    let request = DownloadEpisodeRequest { episode_id: episodes[0].id.clone() };
    let mut chunks = api.episodes.download_episode(request).await.unwrap().into_inner();
    let mut bytes = Vec::new();
    while let Some(chunk) = chunks.message().await.unwrap() {
        bytes.extend_from_slice(&chunk.data);
    }
    assert!(bytes == RECORDINGS[0].bytes, "the recording is the one that was pushed");
}

/// A caller that was interrupted submits again under its key and gets its own job back.
#[tokio::test]
async fn a_key_is_one_job_across_a_restart() {
    let mut server = TestServer::start_with(&["--workers", "0"]).await;
    let mut api = Api::connect(&server).await;
    lab::set_up(&mut api).await;
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

#[tokio::test]
async fn an_upload_goes_on_where_it_stopped() {
    let mut server = TestServer::start_with(&["--workers", "0"]).await;
    let mut api = Api::connect(&server).await;
    lab::create_task(&mut api).await;
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
    let request = GetUploadRequest { upload_id: upload.clone() };
    assert_eq!(api.episodes.get_upload(request).await.unwrap().into_inner().committed_size, committed);
    let gap = lab::write(&mut api, &upload, committed + 1, recording.bytes.slice(half + 1..)).await.unwrap_err();
    assert_eq!(gap.code(), Code::InvalidArgument, "{gap}");
    lab::write(&mut api, &upload, committed, recording.bytes.slice(half..)).await.unwrap();
    assert!(lab::finish(&mut api, &upload).await.unwrap().steps > 0);
}

/// Kills the worker and then the server in the middle of pretraining; the losses and the scores that come out
/// are those of a straight run, bit for bit.
#[tokio::test]
async fn a_killed_job_ends_as_a_straight_one() {
    const STEPS: u32 = 40;
    let mut server = TestServer::start().await;
    let mut api = Api::connect(&server).await;
    let episodes = lab::set_up(&mut api).await;

    let straight = api.succeed(lab::TASK, lab::pretrain(STEPS)).await;

    let killed = api.submit(lab::TASK, lab::pretrain(STEPS)).await.unwrap();
    api.watch_until(&killed.id, |job| job.done >= 7).await;
    for worker in server.workers() {
        let pid = rustix::process::Pid::from_raw(i32::try_from(worker).unwrap()).unwrap();
        rustix::process::kill_process(pid, rustix::process::Signal::KILL).unwrap();
    }
    let second = api.watch_until(&killed.id, |job| job.attempt == 2 && job.done >= 13).await;
    assert!(second.done < u64::from(STEPS), "the test needs a job that is still running");
    server.kill().await;
    server.start_again().await;

    let mut api = Api::connect(&server).await;
    let ended = api.watch(&killed.id).await;
    assert_eq!(ended.state(), JobState::Succeeded, "{}", ended.error);
    let losses = api.metric(&straight.id, "loss").await;
    assert_eq!(last_of_each_step(api.metric(&killed.id, "loss").await), losses);

    let straight_run = api.succeed(lab::TASK, lab::score(&straight.result_id)).await.result_id;
    let killed_run = api.succeed(lab::TASK, lab::score(&killed.result_id)).await.result_id;
    for episode in &episodes {
        let expected = api.episode_scores(&straight_run, &episode.id).await;
        assert_eq!(api.episode_scores(&killed_run, &episode.id).await, expected);
    }
}

/// Steps after the last checkpoint are done again, and reported again: the later report counts.
fn last_of_each_step(values: Vec<(u64, f64)>) -> Vec<(u64, f64)> {
    let by_step: std::collections::BTreeMap<u64, f64> = values.into_iter().collect();
    by_step.into_iter().collect()
}

#[tokio::test]
async fn a_cancelled_job_stops_and_takes_its_dependents_along() {
    let server = TestServer::start().await;
    let mut api = Api::connect(&server).await;
    lab::set_up(&mut api).await;
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
async fn a_stop_lets_a_running_job_resume_later() {
    let mut server = TestServer::start().await;
    let mut api = Api::connect(&server).await;
    lab::set_up(&mut api).await;
    let job = api.submit(lab::TASK, lab::pretrain(30)).await.unwrap();
    api.watch_until(&job.id, |job| job.done >= 6).await;
    assert!(server.stop().await, "a stop on request is a success");
    server.start_again().await;

    let mut api = Api::connect(&server).await;
    let ended = api.watch(&job.id).await;
    assert_eq!((ended.state(), ended.attempt), (JobState::Succeeded, 1), "a stop burns no attempt");
    let steps: Vec<u64> = api.metric(&job.id, "loss").await.into_iter().map(|(step, _)| step).collect();
    assert_eq!(steps, (1..=30).collect::<Vec<_>>(), "a stop loses no step: none is done twice");
}

/// Two servers on one folder would run the same jobs twice.
#[tokio::test]
async fn a_second_server_on_the_same_folder_says_so_and_ends() {
    let server = TestServer::start_with(&["--workers", "0"]).await;
    let second = tokio::process::Command::new(env!("CARGO_BIN_EXE_gleaner-server-under-test"))
        .args(["serve", "--listen", "127.0.0.1:0", "--data-dir"])
        .arg(server.data_dir())
        .stdin(std::process::Stdio::null())
        .kill_on_drop(true)
        .output()
        .await
        .unwrap();
    let said = String::from_utf8_lossy(&[second.stdout, second.stderr].concat()).into_owned();
    assert!(!second.status.success() && said.contains(&server.data_dir().display().to_string()), "{said}");
    assert!(!said.contains("listening"), "{said}");
    // The first serves on.
    Api::connect(&server).await.jobs.list_jobs(ListJobsRequest::default()).await.unwrap();
}
