//! A grid of settings on a cluster: its jobs run side by side on the nodes, with the results of the server's own machine.

use std::path::Path;

use gleaner_proto::v1::*;
use serde_json::Value;

use crate::support::{
    api::Api,
    experiments::{SETTINGS, experiment},
    server::TestServer,
    slurm::Cluster,
};

/// The results of two methods with two seeds each, by jobs of a server.
async fn cells(server: &TestServer, folder: &Path) -> Value {
    std::fs::create_dir(folder).unwrap();
    let (file, out) = (folder.join("grid.toml"), folder.join("out"));
    let study = "[[study]]\ntable = \"methods\"\naxes = { method = [\"bc\", \"tf_bc\"] }\n";
    std::fs::write(&file, SETTINGS.replace("seeds = [0]", "seeds = [0, 1]") + study).unwrap();
    let (success, text) = experiment(server.url(), &file, &out, &[]).await;
    assert!(success, "{text}");
    let report: Value = serde_json::from_slice(&std::fs::read(out.join("report.json")).unwrap()).unwrap();
    report["studies"][0]["cells"].clone()
}

#[tokio::test]
async fn jobs_of_an_experiment_run_side_by_side_on_the_nodes_with_the_results_of_local_ones() {
    let Some(cluster) = Cluster::start(2).await else { return };
    let folder = tempfile::tempdir().unwrap();
    let local = cells(&TestServer::start().await, &folder.path().join("local")).await;
    let flags = cluster.flags();
    let server = TestServer::start_with(&flags.iter().map(String::as_str).collect::<Vec<_>>()).await;
    let remote = cells(&server, &folder.path().join("slurm")).await;
    assert_eq!(remote, local);
    assert_eq!(remote.as_array().unwrap().len(), 2);

    let mut api = Api::connect(&server).await;
    let jobs = api.jobs.list_jobs(ListJobsRequest::default()).await.unwrap().into_inner().jobs;
    assert_eq!(jobs.len(), 8, "two methods with two seeds each, trained and evaluated");
    assert!(jobs.iter().all(|job| job.engine == "slurm"), "{jobs:?}");
    let span =
        |job: &Job| [job.start_time, job.end_time].map(|time| time.map(|time| (time.seconds, time.nanos)).unwrap());
    let beside = |one: &Job, other: &Job| {
        let ([begun, ended], [other_begun, other_ended]) = (span(one), span(other));
        one.node != other.node && begun < other_ended && other_begun < ended
    };
    assert!(jobs.iter().any(|one| jobs.iter().any(|other| beside(one, other))), "on two nodes at once: {jobs:?}");
    cluster.until_empty().await;
}
