//! Nodes that differ from the server's machine: without the worker or srun, and with a clock that is an hour off.

use std::{fs, path::Path, time::SystemTime};

use gleaner_client::{Client, Credentials};
use gleaner_proto::v1::*;

use crate::support::{api::Api, command, lab, server::TestServer, skipped::skipped, slurm::Cluster, wait::until};

/// The library that changes the clock of a process, for programs with several threads.
const FAKETIME: &str = "/usr/lib/x86_64-linux-gnu/faketime/libfaketimeMT.so.1";

/// The job fails with the flags to check, its log has the words of the node's shell, and the server serves.
#[tokio::test]
async fn job_whose_node_has_no_worker_or_no_srun_fails_with_the_flags_to_check() {
    let Some(cluster) = Cluster::start(2).await else { return };
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    let (mut server, _, _) = lab::over(&data).await;
    let cases: [(&[&str], &str); 2] = [
        (&["--slurm-worker", "/nowhere/gleaner-worker"], "/nowhere/gleaner-worker: "),
        (&["--slurm-setup", "PATH=/nowhere", "--pretrain-ranks", "2"], "srun: not found"),
    ];
    for (wrong, words) in cases {
        assert!(server.stop().await);
        let flags = cluster.flags();
        let flags: Vec<&str> = flags.iter().map(String::as_str).chain(wrong.iter().copied()).collect();
        server = TestServer::start_over(&data, &flags).await;
        let mut api = Api::connect(&server).await;
        let request = SubmitJobRequest {
            task: lab::TASK.into(),
            spec: Some(JobSpec { spec: Some(lab::pretrain(2)) }),
            max_attempts: Some(1),
            ..SubmitJobRequest::default()
        };
        let id = api.jobs.submit_job(request).await.unwrap().into_inner().job.unwrap().id;
        let ended = api.watch(&id).await;
        assert_eq!(ended.state(), JobState::Failed, "{ended:?}");
        let hint = "see the log, and where the worker did not start, --slurm-worker and --slurm-setup";
        assert!(ended.error.contains(hint), "{}", ended.error);
        until("the log has the words of the shell", async || {
            super::job(&mut api, &id).await.log.contains(words).then_some(())
        })
        .await;
    }
    cluster.until_empty().await;
}

/// The certificates are new: they begin a day before, so that they are valid by a clock that is behind, too.
#[tokio::test]
async fn jobs_by_tls_on_a_node_whose_clock_is_an_hour_off_succeed_with_the_losses_of_others() {
    if !Path::new(FAKETIME).exists() {
        return skipped("libfaketime is not installed (Debian: faketime)");
    }
    let Some(cluster) = Cluster::start(1).await else { return };
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name).display().to_string();
    let (data, setup, seen) = (folder.path().join("data"), file("setup"), file("seen"));
    let (mut server, mut api, _) = lab::over(&data).await;
    let undisturbed = api.succeed(lab::TASK, lab::pretrain(2)).await;
    let expected = api.metric(&undisturbed.id, "loss").await;
    assert!(server.stop().await);

    let (success, text) = command::server_text(&["tls", "init"], &data).await;
    assert!(success, "{text}");
    let (cert, key, ca) = (file("data/tls/server.pem"), file("data/tls/server.key"), file("data/tls/ca.pem"));
    // The node reads the file when a job starts.
    let sourced = format!(". '{setup}'");
    let more = ["--tls-cert", &cert, "--tls-key", &key, "--worker-ca", &ca, "--slurm-setup", &sourced];
    let flags = cluster.flags();
    let flags: Vec<&str> = flags.iter().map(String::as_str).chain(more).collect();
    let server = TestServer::start_over(&data, &flags).await;
    let credentials = Credentials { token: None, ca: Some(fs::read(&ca).unwrap()), identity: None };
    let client = Client::connect_with(server.url(), credentials).await.unwrap();
    for hours in [-1_i64, 1] {
        // A clock that is off changes neither the monotonic clock nor the times of files.
        let faked = format!("LD_PRELOAD={FAKETIME} FAKETIME={hours:+}h FAKETIME_DONT_FAKE_MONOTONIC=1 NO_FAKE_STAT=1");
        fs::write(&setup, format!("export {faked}\ndate +%s > '{seen}'\n")).unwrap();
        assert_eq!(super::pretrain(&client).await, expected, "{hours} h");
        let there: i64 = fs::read_to_string(&seen).unwrap().trim().parse().unwrap();
        let here = i64::try_from(SystemTime::UNIX_EPOCH.elapsed().unwrap().as_secs()).unwrap();
        assert!((there - here - 3600 * hours).abs() < 600, "{there} on the node, {here} here");
    }
    cluster.until_empty().await;
}
