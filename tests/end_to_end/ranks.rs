//! Trainings that several processes of this machine share: the losses of one process, the same bits in every run, and the
//! end of a rank.

use gleaner_proto::v1::*;

use crate::support::{
    api::Api,
    lab,
    process::{Signal, signal_rank_1},
    server::TestServer,
};

const TWO: [&str; 4] = ["--pretrain-ranks", "2", "--train-ranks", "2"];

/// The last value of each step: steps after the last checkpoint run and are reported again.
async fn losses(api: &mut Api, job: &str) -> Vec<(u64, f64)> {
    let by_step: std::collections::BTreeMap<u64, f64> = api.metric(job, "loss").await.into_iter().collect();
    by_step.into_iter().collect()
}

fn assert_close(one: &[(u64, f64)], other: &[(u64, f64)]) {
    assert_eq!(one.len(), other.len());
    for ((step, one), (_, other)) in one.iter().zip(other) {
        assert!((one - other).abs() < 1e-3 * one.abs(), "step {step}: {one} and {other}");
    }
}

#[tokio::test]
async fn two_ranks_have_the_losses_of_one_process_and_repeat_bit_for_bit() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    let (mut server, mut api, episodes) = lab::over(&data).await;
    let alone = api.succeed(lab::TASK, lab::pretrain(8)).await;
    let experts = || train_spec::Data::ExpertsOf(alone.result_id.clone());
    let trained_alone = api.succeed(lab::TASK, lab::train(experts(), 8)).await;
    assert!(server.stop().await);

    let server = TestServer::start_over(&data, &TWO).await;
    let mut api = Api::connect(&server).await;
    let (mut pretrained, mut trained) = (Vec::new(), Vec::new());
    for _ in 0..2 {
        let job = api.succeed(lab::TASK, lab::pretrain(8)).await;
        let run = api.succeed(lab::TASK, lab::score(&job.result_id)).await.result_id;
        let mut scores = Vec::new();
        for episode in &episodes {
            scores.push(api.episode_scores(&run, &episode.id).await);
        }
        pretrained.push((losses(&mut api, &job.id).await, scores));
        let job = api.succeed(lab::TASK, lab::train(experts(), 8)).await;
        trained.push(losses(&mut api, &job.id).await);
        assert_eq!(api.metric(&job.id, "summing_share").await.len(), 8);
    }
    assert_eq!(pretrained[0], pretrained[1]);
    assert_eq!(trained[0], trained[1]);
    assert_close(&losses(&mut api, &alone.id).await, &pretrained[0].0);
    assert_close(&losses(&mut api, &trained_alone.id).await, &trained[0]);
}

/// A rank that is killed is noticed at once, and one that hangs after the timeout. The attempt has saved a checkpoint, so it
/// does not count.
#[tokio::test]
async fn job_resumes_from_its_checkpoint_after_a_rank_is_killed_or_hangs() {
    const STEPS: u32 = 40;
    let flags = [&TWO[..], &["--rank-timeout-seconds", "10"]].concat();
    let (server, mut api, _) = lab::with_episodes(&flags).await;
    let expected = api.succeed(lab::TASK, lab::pretrain(STEPS)).await;
    for sent in [Signal::KILL, Signal::STOP] {
        let job = api.submit(lab::TASK, lab::pretrain(STEPS)).await.unwrap();
        api.watch_until(&job.id, |job| job.done >= 7).await;
        signal_rank_1(server.pid(), sent);
        let ended = api.watch(&job.id).await;
        assert_eq!((ended.state(), ended.attempt), (JobState::Succeeded, 1), "{}", ended.error);
        assert_eq!(losses(&mut api, &job.id).await, losses(&mut api, &expected.id).await);
        let request = GetJobRequest { job_id: job.id.clone() };
        let log = api.jobs.get_job(request).await.unwrap().into_inner().log;
        let reason = if sent == Signal::KILL { "rank 1: the worker was killed by signal 9" } else { "within 10 s" };
        assert!(log.contains(reason), "{log}");
    }
}

/// A batch that is smaller than the number of ranks is an error of the job, not of an attempt.
#[tokio::test]
async fn batch_smaller_than_the_ranks_fails_the_job_with_its_reason() {
    let (_server, mut api, _) = lab::with_episodes(&TWO).await;
    let spec = lab::with(lab::pretrain(4), serde_json::json!({"batch": 1}));
    let job = api.submit(lab::TASK, spec).await.unwrap();
    let ended = api.watch(&job.id).await;
    assert_eq!((ended.state(), ended.attempt), (JobState::Failed, 1), "{ended:?}");
    assert!(ended.error.starts_with("batch: is 1, fewer segments than the 2 ranks"), "{}", ended.error);
}
