//! Evaluations that several processes of this machine share: the same results for any number, and the end of a process.

use gleaner_proto::v1::*;
use serde_json::json;

use crate::support::{
    api::Api,
    lab,
    process::{Signal, signal_rank_1},
    server::TestServer,
};

/// An evaluation of several seeds, each of several blocks of attempts.
fn evaluate(policy: &str, max_steps: u32) -> job_spec::Spec {
    lab::evaluate(policy, json!({"episodes": 70, "seeds": [0, 5], "max_steps": max_steps}))
}

/// The results of each seed and what the policy looked at.
async fn results(api: &mut Api, job: &Job) -> (Vec<SeedResult>, Vec<(String, u64)>) {
    let request = ListMetricsRequest { job_id: job.id.clone() };
    let metrics = api.jobs.list_metrics(request).await.unwrap().into_inner().metrics;
    let shares = metrics.into_iter().map(|metric| (metric.name, metric.value.to_bits()));
    (api.evaluation(&job.result_id).await.seeds, shares.collect())
}

#[tokio::test]
async fn one_two_and_three_processes_give_the_same_results() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    let (mut server, mut api, _) = lab::over(&data).await;
    let policy = api.train_policy(3).await.1;
    let job = api.succeed(lab::TASK, evaluate(&policy, 12)).await;
    let expected = results(&mut api, &job).await;
    assert!(expected.0.iter().all(|seed| seed.episodes == 70 && seed.mean_steps > 0.0), "{expected:?}");
    assert!(expected.1.iter().any(|(name, _)| name == "share_images"), "{expected:?}");
    for ranks in ["2", "3"] {
        assert!(server.stop().await);
        server = TestServer::start_over(&data, &["--evaluate-ranks", ranks]).await;
        api = Api::connect(&server).await;
        let job = api.succeed(lab::TASK, evaluate(&policy, 12)).await;
        assert_eq!((job.done, job.total), (140, 140));
        assert_eq!(results(&mut api, &job).await, expected, "{ranks} processes");
    }
}

#[tokio::test]
async fn evaluation_whose_process_ends_or_hangs_is_repeated_with_the_same_results() {
    let flags = ["--evaluate-ranks", "2", "--rank-timeout-seconds", "10"];
    let (server, mut api, _) = lab::with_episodes(&flags).await;
    let policy = api.train_policy(3).await.1;
    // Attempts of this many steps take seconds.
    let steps = 200;
    let job = api.succeed(lab::TASK, evaluate(&policy, steps)).await;
    assert_eq!(job.attempt, 1);
    let expected = results(&mut api, &job).await;
    for sent in [Signal::KILL, Signal::STOP] {
        let job = api.submit(lab::TASK, evaluate(&policy, steps)).await.unwrap();
        api.watch_until(&job.id, |job| job.message == "evaluating").await;
        signal_rank_1(server.pid(), sent);
        let ended = api.watch(&job.id).await;
        assert_eq!((ended.state(), ended.attempt), (JobState::Succeeded, 2), "{}", ended.error);
        assert_eq!(results(&mut api, &ended).await, expected);
    }
}
