//! Trainings that two nodes share, by srun.

use gleaner_proto::v1::*;

use super::losses;
use crate::support::{api::Api, lab, server::TestServer, slurm::Cluster};

#[tokio::test]
async fn training_over_two_nodes_equals_a_local_one_and_resumes_after_a_node_is_killed() {
    const STEPS: u32 = 40;
    let Some(mut cluster) = Cluster::start(2).await else { return };
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    let two = ["--pretrain-ranks", "2", "--rank-timeout-seconds", "30"];
    let mut server = TestServer::start_over(&data, &two).await;
    let mut api = Api::connect(&server).await;
    lab::set_up(&mut api).await;
    let local = api.succeed(lab::TASK, lab::pretrain(STEPS)).await;
    assert!(server.stop().await);

    let flags = cluster.flags();
    let flags: Vec<&str> = flags.iter().map(String::as_str).chain(two).collect();
    let server = TestServer::start_over(&data, &flags).await;
    let mut api = Api::connect(&server).await;
    let expected = losses(&mut api, &local.id).await;
    let remote = api.succeed(lab::TASK, lab::pretrain(STEPS)).await;
    assert_eq!(losses(&mut api, &remote.id).await, expected);
    assert!(remote.node.contains("1-2"), "both nodes: {remote:?}");
    assert_eq!(remote.attempt, 1);

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
