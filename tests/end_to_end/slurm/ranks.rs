//! Trainings, score runs and evaluations that several nodes share, by srun.

use std::collections::BTreeSet;

use gleaner_proto::v1::*;
use serde_json::json;

use super::losses;
use crate::support::{
    api::Api,
    files::{blobs, forget_features},
    lab,
    scores::digest,
    server::TestServer,
    slurm::Cluster,
    wait::until,
};

#[tokio::test]
async fn training_over_two_nodes_equals_a_local_one_and_resumes_after_a_node_is_killed() {
    const STEPS: u32 = 40;
    let Some(mut cluster) = Cluster::start(2).await else { return };
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    let two = ["--pretrain-ranks", "2", "--train-ranks", "2", "--rank-timeout-seconds", "30"];
    let mut server = TestServer::start_over(&data, &two).await;
    let mut api = Api::connect(&server).await;
    lab::set_up(&mut api).await;
    let local = api.succeed(lab::TASK, lab::pretrain(STEPS)).await;
    let train = || lab::train(train_spec::Data::ExpertsOf(local.result_id.clone()), 2);
    let trained = api.succeed(lab::TASK, train()).await;
    assert!(server.stop().await);
    // Recordings, the encoder and the policy: checkpoints end with their jobs.
    let stored = || blobs(&data).into_iter().collect::<BTreeSet<_>>();
    let results = stored();

    let flags = cluster.flags_for_lost_nodes();
    let flags: Vec<&str> = flags.iter().map(String::as_str).chain(two).collect();
    let server = TestServer::start_over(&data, &flags).await;
    let mut api = Api::connect(&server).await;
    let expected = losses(&mut api, &local.id).await;
    let remote = api.succeed(lab::TASK, lab::pretrain(STEPS)).await;
    assert_eq!(losses(&mut api, &remote.id).await, expected);
    assert!(remote.node.contains("1-2"), "both nodes: {remote:?}");
    assert_eq!(remote.attempt, 1);
    let policy = api.succeed(lab::TASK, train()).await;
    assert_eq!(losses(&mut api, &policy.id).await, losses(&mut api, &trained.id).await);
    assert!(policy.node.contains("1-2"), "both nodes: {policy:?}");
    until("the results are the files of the local ones", async || (stored() == results).then_some(())).await;

    let killed = api.submit(lab::TASK, lab::pretrain(STEPS)).await.unwrap();
    api.watch_until(&killed.id, |job| job.done >= 7).await;
    cluster.kill_node("node2").await;
    // The cluster has no other node for the next attempt.
    cluster.revive("node2");
    let ended = api.watch(&killed.id).await;
    assert_eq!((ended.state(), ended.attempt), (JobState::Succeeded, 1), "{}", ended.error);
    assert_eq!(losses(&mut api, &killed.id).await, expected);
    cluster.until_empty().await;
}

#[tokio::test]
async fn score_run_over_nodes_gives_the_bytes_of_a_local_one_also_after_a_node_is_killed() {
    let Some(mut cluster) = Cluster::start(3).await else { return };
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    let (mut server, mut api, _) = lab::over(&data).await;
    // A larger model takes seconds to encode the episodes.
    let encoder = api.succeed(lab::TASK, lab::with(lab::pretrain(1), json!({"preset": "base"}))).await.result_id;
    let score = || lab::with(lab::score(&encoder), json!({"scorer": "ssdf"}));
    let local = api.succeed(lab::TASK, score()).await.result_id;
    let expected = digest(&mut api, &local).await;
    for ranks in ["1", "2", "3"] {
        assert!(server.stop().await);
        let flags = [cluster.flags_for_lost_nodes(), ["--score-ranks", ranks].map(str::to_owned).to_vec()].concat();
        server = TestServer::start_over(&data, &flags.iter().map(String::as_str).collect::<Vec<_>>()).await;
        api = Api::connect(&server).await;
        let job = api.succeed(lab::TASK, score()).await;
        assert_eq!(digest(&mut api, &job.result_id).await, expected, "{ranks} nodes");
        assert_eq!((job.engine.as_str(), job.attempt), ("slurm", 1), "{job:?}");
        assert_eq!(job.node.contains(&format!("1-{ranks}")), ranks != "1", "{job:?}");
    }
    // Kept features would end the run before its node is killed.
    forget_features(&data);
    let killed = api.submit(lab::TASK, score()).await.unwrap();
    let running = api.watch_until(&killed.id, |job| job.message == "scoring").await;
    cluster.kill_node("node3").await;
    // The cluster has no other node for the next attempt.
    cluster.revive("node3");
    let ended = api.watch(&killed.id).await;
    assert_eq!(ended.state(), JobState::Succeeded, "{}", ended.error);
    assert_ne!(ended.engine_id, running.engine_id, "the node was lost in the middle of the run");
    assert_eq!(digest(&mut api, &ended.result_id).await, expected);
    cluster.until_empty().await;
}

#[tokio::test]
async fn evaluation_over_two_nodes_gives_the_results_of_a_local_one() {
    let Some(cluster) = Cluster::start(2).await else { return };
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    let (mut server, mut api, _) = lab::over(&data).await;
    let policy = api.train_policy(3).await.1;
    let evaluate = || lab::evaluate(&policy, json!({"episodes": 100, "seeds": [3, 1], "max_steps": 12}));
    let local = api.succeed(lab::TASK, evaluate()).await;
    let expected = api.evaluation(&local.result_id).await.seeds;
    assert!(server.stop().await);

    let flags = [cluster.flags(), ["--evaluate-ranks", "2"].map(str::to_owned).to_vec()].concat();
    let server = TestServer::start_over(&data, &flags.iter().map(String::as_str).collect::<Vec<_>>()).await;
    let mut api = Api::connect(&server).await;
    let job = api.succeed(lab::TASK, evaluate()).await;
    assert_eq!(api.evaluation(&job.result_id).await.seeds, expected);
    assert!(job.engine == "slurm" && job.node.contains("1-2"), "both nodes: {job:?}");
    cluster.until_empty().await;
}
