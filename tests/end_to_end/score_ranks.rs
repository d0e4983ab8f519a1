//! Score runs that several processes of this machine share: the same bytes for any number, and the end of a process.

use gleaner_proto::v1::*;
use serde_json::json;

use crate::support::{
    api::Api,
    files::forget_features,
    lab,
    process::{Signal, signal_rank_1},
    scores::digest,
    server::TestServer,
};

/// Scores by each scorer that compares segments, from the start and as an extension; by one that does not, from the start.
async fn runs(api: &mut Api, encoder: &str, snapshots: [&str; 2]) -> Vec<blake3::Hash> {
    let mut digests = Vec::new();
    for scorer in ["raw", "ssdf", "vote"] {
        let mut extends = String::new();
        for snapshot in snapshots {
            let settings = extends.is_empty().then(|| json!({"scorer": scorer, "normaliser": "quantile"}));
            let spec = ScoreSpec {
                encoder_id: if extends.is_empty() { encoder.to_owned() } else { String::new() },
                snapshot_id: snapshot.to_owned(),
                settings: settings.and_then(lab::settings),
                extends,
            };
            let job = api.succeed(lab::TASK, job_spec::Spec::Score(spec)).await;
            assert!(job.done == job.total && job.total > 0, "{job:?}");
            digests.push(digest(api, &job.result_id).await);
            extends = if scorer == "vote" { String::new() } else { job.result_id };
        }
    }
    digests
}

async fn snapshot(api: &mut Api, max_experts: u32) -> String {
    let rule = RoleRule { max_experts, seed: 9, ..RoleRule::default() };
    let request = CreateSnapshotRequest { task: lab::TASK.into(), rule: Some(rule) };
    api.snapshots.create_snapshot(request).await.unwrap().into_inner().snapshot.unwrap().id
}

#[tokio::test]
async fn one_two_and_three_processes_give_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    let (mut server, mut api, _) = lab::over(&data).await;
    let encoder = api.succeed(lab::TASK, lab::pretrain(8)).await.result_id;
    let (small, whole) = (snapshot(&mut api, 4).await, snapshot(&mut api, 0).await);
    let expected = runs(&mut api, &encoder, [&small, &whole]).await;
    let different: std::collections::HashSet<_> = expected.iter().collect();
    assert_eq!(different.len(), expected.len(), "every run has other scores");
    for ranks in ["2", "3"] {
        assert!(server.stop().await);
        // Features of the runs before would spare these the encoding.
        std::fs::remove_dir_all(data.join("cache")).unwrap();
        server = TestServer::start_over(&data, &["--score-ranks", ranks]).await;
        api = Api::connect(&server).await;
        assert_eq!(runs(&mut api, &encoder, [&small, &whole]).await, expected, "{ranks} processes");
    }
}

#[tokio::test]
async fn run_whose_process_is_killed_in_the_middle_is_repeated_with_the_same_bytes() {
    let flags = ["--score-ranks", "2", "--rank-timeout-seconds", "10"];
    let (server, mut api, _) = lab::with_episodes(&flags).await;
    // A larger model takes seconds to encode the episodes.
    let encoder = api.succeed(lab::TASK, lab::with(lab::pretrain(1), json!({"preset": "base"}))).await.result_id;
    let score = || lab::with(lab::score(&encoder), json!({"scorer": "ssdf"}));
    let expected = api.succeed(lab::TASK, score()).await;
    assert_eq!(expected.attempt, 1);
    let expected = digest(&mut api, &expected.result_id).await;
    for sent in [Signal::KILL, Signal::STOP] {
        // Kept features would end the run before the signal.
        forget_features(server.data_dir());
        let job = api.submit(lab::TASK, score()).await.unwrap();
        api.watch_until(&job.id, |job| job.message == "scoring").await;
        signal_rank_1(server.pid(), sent);
        let ended = api.watch(&job.id).await;
        assert_eq!((ended.state(), ended.attempt), (JobState::Succeeded, 2), "{}", ended.error);
        assert_eq!(digest(&mut api, &ended.result_id).await, expected);
        let log = api.jobs.get_job(GetJobRequest { job_id: job.id }).await.unwrap().into_inner().log;
        let reason = if sent == Signal::KILL { "rank 1: the worker was killed by signal 9" } else { "within 10 s" };
        assert!(log.contains(reason), "{log}");
    }
}
