//! Training that is killed over and over ends with the same weights, the same state of the optimiser and the same
//! losses as training that never was.

use std::{collections::BTreeSet, path::Path, time::Duration};

use gleaner_proto::v1::*;
use rand::{RngExt as _, rngs::StdRng};
use rustix::process::{Pid, Signal, kill_process};

use super::{Settings, check};
use crate::{api::Api, lab, server::TestServer};

/// Where a worker has done everything and told nobody: the last checkpoint, which holds the optimiser's state, is still
/// there, and so is the result.
const LAST_MOMENT: &str = "result.blob_kept";

/// What a training job leaves.
#[derive(Debug, PartialEq)]
struct Left {
    /// The digests of its last checkpoint and of its result: weights, and the state of the optimiser. They are taken at
    /// two moments, because the last checkpoint goes when the result is named.
    blobs: [BTreeSet<String>; 2],
    /// Every metric but the time a step took.
    metrics: Vec<(u64, String, u64)>,
}

/// Its blobs, beside those of the recordings.
fn blobs(data_dir: &Path, before: &BTreeSet<String>) -> BTreeSet<String> {
    let names =
        super::blob_files(data_dir).into_iter().map(|path| path.file_name().unwrap().to_str().unwrap().to_owned());
    let names: BTreeSet<String> = names.collect();
    names.difference(before).cloned().collect()
}

/// Those that a row names: after a kill, and for a moment after a job's end, a checkpoint may be left that is removed
/// later.
async fn named(data_dir: &Path, before: &BTreeSet<String>) -> BTreeSet<String> {
    let said = check::check_is_clean(data_dir).await;
    let mut named = blobs(data_dir, before);
    named.retain(|blob| !said.lines().any(|line| line.starts_with("note: blob ") && line.contains(blob)));
    named
}

async fn metrics(api: &mut Api, job: &str) -> Vec<(u64, String, u64)> {
    let request = ListMetricsRequest { job_id: job.to_owned() };
    let metrics = api.jobs.list_metrics(request).await.unwrap().into_inner().metrics;
    let timeless = metrics.into_iter().filter(|metric| metric.name != "ms_per_step");
    timeless.map(|metric| (metric.step, metric.name, metric.value.to_bits())).collect()
}

fn spec(steps: u32) -> job_spec::Spec {
    lab::with(lab::pretrain(steps), serde_json::json!({"checkpoint_every": 4}))
}

async fn submit(api: &mut Api, steps: u32) -> Job {
    let request = SubmitJobRequest {
        task: lab::TASK.into(),
        spec: Some(JobSpec { spec: Some(spec(steps)) }),
        // Kills of the worker alone count.
        max_attempts: Some(90),
        ..SubmitJobRequest::default()
    };
    api.jobs.submit_job(request).await.unwrap().into_inner().job.unwrap()
}

/// Lets the job run to its last moment, where the server dies with it, looks, and lets it end.
async fn end(server: &mut TestServer, job: &str, before: &BTreeSet<String>) -> Left {
    assert!(server.start_where_it_was(Some(LAST_MOMENT)).await);
    server.died().await;
    let checkpoint = named(server.data_dir(), before).await;
    assert!(server.start_where_it_was(None).await);
    let mut api = Api::connect(server).await;
    let ended = api.watch(job).await;
    assert_eq!(ended.state(), JobState::Succeeded, "{}", ended.error);
    let result = named(server.data_dir(), before).await;
    Left { blobs: [checkpoint, result], metrics: metrics(&mut api, job).await }
}

/// Waits until this life of the job is beyond a step, and follows it for a random moment longer: to anywhere in the steps
/// after it, or in the writing of a checkpoint.
async fn beyond(api: &mut Api, job: &str, step: u64, random: &mut StdRng) -> u64 {
    let request = WatchJobRequest { job_id: job.to_owned() };
    let mut events = api.jobs.watch_job(request).await.unwrap().into_inner();
    let mut reached = None;
    let watching = async {
        while let Some(event) = events.message().await.unwrap() {
            let newest = event.metrics.iter().map(|metric| metric.step).max().unwrap_or(0);
            // What the first event says was said before this life.
            let first = *reached.get_or_insert(newest);
            if newest > first && newest >= step {
                return newest;
            }
            assert!(!gleaner_client::has_ended(event.job.unwrap().state()), "the job ended before its last kill");
        }
        panic!("the job ended before its last kill");
    };
    let newest = tokio::time::timeout(Duration::from_secs(240), watching).await.expect("the job took too long");
    let moment = Duration::from_millis(random.random_range(0..120));
    let _ = tokio::time::timeout(moment, async { while let Ok(Some(_)) = events.message().await {} }).await;
    newest
}

#[tokio::test]
async fn training_killed_at_random_steps_ends_as_if_it_never_was() {
    let settings = Settings::read();
    let kills = settings.training_kills;
    let steps = u32::try_from(kills).unwrap() * 12 + 40;
    let mut server = TestServer::start().await;
    let mut api = Api::connect(&server).await;
    lab::set_up(&mut api).await;
    let recordings = blobs(server.data_dir(), &BTreeSet::new());

    let straight = api.succeed(lab::TASK, spec(steps)).await;
    let straight_metrics = metrics(&mut api, &straight.id).await;
    server.kill().await;
    let result = named(server.data_dir(), &recordings).await;
    assert_eq!(result.len(), 1, "{result:?}");

    assert!(server.start_where_it_was(Some(LAST_MOMENT)).await);
    let once = submit(&mut Api::connect(&server).await, steps).await;
    server.died().await;
    let once = end(&mut server, &once.id, &recordings).await;
    let [checkpoint, again] = &once.blobs;
    assert_eq!(*again, result, "the same weights as without a crash");
    assert_eq!(checkpoint.difference(&result).count(), 1, "and a checkpoint: {checkpoint:?}");
    assert_eq!(once.metrics, straight_metrics);

    let mut random = settings.random(3);
    let job = submit(&mut Api::connect(&server).await, steps).await;
    let mut killed_at = Vec::new();
    for kill in 0..kills {
        let step = 12 * kill as u64 + random.random_range(1..12);
        let mut api = Api::connect(&server).await;
        killed_at.push(beyond(&mut api, &job.id, step, &mut random).await);
        // The worker alone, or the server and with it the worker.
        if kill % 2 == 0 {
            for worker in server.workers() {
                let pid = Pid::from_raw(i32::try_from(worker).unwrap()).unwrap();
                // One that has ended by itself meanwhile is gone.
                let _ = kill_process(pid, Signal::KILL);
            }
        } else {
            server.kill().await;
            assert!(server.start_where_it_was(None).await);
        }
    }
    server.kill().await;
    let left = end(&mut server, &job.id, &recordings).await;
    eprintln!("killed at {killed_at:?} of {steps} steps");
    assert_eq!(left.blobs, once.blobs, "weights and the state of the optimiser");
    assert_eq!(left.metrics, straight_metrics, "losses");
}
