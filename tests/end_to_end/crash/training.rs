//! Training that is killed many times ends with the same weights, optimiser state and losses as uninterrupted training.

use std::{collections::BTreeSet, path::Path, time::Duration};

use gleaner_proto::v1::*;
use rand::{RngExt as _, rngs::StdRng};

use crate::support::{
    api::Api,
    crash::{Settings, check},
    files, lab,
    server::TestServer,
    wait::within,
};

/// The fail point between the end of a worker's job and its report: the last checkpoint, with the state of the optimiser,
/// and the result both exist.
const LAST_MOMENT: &str = "result.blob_kept";

/// The files and metrics of a training job.
#[derive(Debug, PartialEq)]
struct Trained {
    /// The digests of its last checkpoint (weights and the state of the optimiser) and of its result. They are read at two
    /// moments, because the checkpoint is removed once the result is committed.
    blobs: [BTreeSet<String>; 2],
    /// Every metric but the time a step took.
    metrics: Vec<(u64, String, u64)>,
}

/// The digests' last parts of all blobs except those that existed before.
fn blobs(data_dir: &Path, before: &BTreeSet<String>) -> BTreeSet<String> {
    let names = files::blobs(data_dir).into_iter().map(|path| path.file_name().unwrap().to_str().unwrap().to_owned());
    let names: BTreeSet<String> = names.collect();
    names.difference(before).cloned().collect()
}

/// The blobs with a row: after a kill, and for a moment after the end of a job, a checkpoint without one may be left.
async fn named(data_dir: &Path, before: &BTreeSet<String>) -> BTreeSet<String> {
    let text = check::expect_sound(data_dir).await;
    let mut named = blobs(data_dir, before);
    named.retain(|blob| !text.lines().any(|line| line.starts_with("note: blob ") && line.contains(blob)));
    named
}

async fn metrics(api: &mut Api, job: &str) -> Vec<(u64, String, u64)> {
    let request = ListMetricsRequest { job_id: job.to_owned() };
    let metrics = api.jobs.list_metrics(request).await.unwrap().into_inner().metrics;
    let timeless = metrics
        .into_iter()
        .filter(|metric| !["ms_per_step", "ms_per_batch", "waited_share"].contains(&metric.name.as_str()));
    timeless.map(|metric| (metric.step, metric.name, metric.value.to_bits())).collect()
}

fn spec(steps: u32) -> job_spec::Spec {
    lab::with(lab::pretrain(steps), serde_json::json!({"checkpoint_every": 4}))
}

async fn submit(api: &mut Api, steps: u32) -> Job {
    let request = SubmitJobRequest {
        task: lab::TASK.into(),
        spec: Some(JobSpec { spec: Some(spec(steps)) }),
        // Kills of the worker alone count as attempts.
        max_attempts: Some(90),
        ..SubmitJobRequest::default()
    };
    api.jobs.submit_job(request).await.unwrap().into_inner().job.unwrap()
}

/// Runs the job to its last fail point, where the server dies with it, then to its end.
async fn end(server: &mut TestServer, job: &str, before: &BTreeSet<String>) -> Trained {
    assert!(server.start_where_it_was(Some(LAST_MOMENT)).await);
    server.ended().await;
    let checkpoint = named(server.data_dir(), before).await;
    assert!(server.start_where_it_was(None).await);
    let mut api = Api::connect(server).await;
    let ended = api.watch(job).await;
    assert_eq!(ended.state(), JobState::Succeeded, "{}", ended.error);
    let result = named(server.data_dir(), before).await;
    Trained { blobs: [checkpoint, result], metrics: metrics(&mut api, job).await }
}

/// Waits until this attempt of the job has passed a step, and for a random time after it: into any later step, or into the
/// write of a checkpoint.
async fn pass_step(api: &mut Api, job: &str, step: u64, random: &mut StdRng) -> u64 {
    let request = WatchJobRequest { job_id: job.to_owned() };
    let mut events = api.jobs.watch_job(request).await.unwrap().into_inner();
    let mut reached = None;
    let watching = async {
        while let Some(event) = events.message().await.unwrap() {
            let newest = event.metrics.iter().map(|metric| metric.step).max().unwrap_or(0);
            // The first event repeats metrics of earlier attempts.
            let first = *reached.get_or_insert(newest);
            if newest > first && newest >= step {
                return newest;
            }
            assert!(!gleaner_client::has_ended(event.job.unwrap().state()), "the job ended before its last kill");
        }
        panic!("the job ended before its last kill");
    };
    let newest = within("the job passes the step", watching).await;
    let moment = Duration::from_millis(random.random_range(0..120));
    let _ = tokio::time::timeout(moment, async { while let Ok(Some(_)) = events.message().await {} }).await;
    newest
}

#[tokio::test]
async fn killed_training_equals_uninterrupted_training() {
    let settings = Settings::read();
    let kills = settings.training_kills;
    let steps = u32::try_from(kills).unwrap() * 12 + 40;
    let (mut server, mut api, _) = lab::with_episodes(&[]).await;
    let recordings = blobs(server.data_dir(), &BTreeSet::new());

    let straight = api.succeed(lab::TASK, spec(steps)).await;
    let straight_metrics = metrics(&mut api, &straight.id).await;
    server.kill().await;
    let result = named(server.data_dir(), &recordings).await;
    assert_eq!(result.len(), 1, "{result:?}");

    assert!(server.start_where_it_was(Some(LAST_MOMENT)).await);
    let once = submit(&mut Api::connect(&server).await, steps).await;
    server.ended().await;
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
        killed_at.push(pass_step(&mut api, &job.id, step, &mut random).await);
        // The worker alone, or the server and with it the worker.
        if kill % 2 == 0 {
            server.kill_workers();
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
