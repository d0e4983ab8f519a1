//! What takes minutes by Slurm's own clock: a time limit, and a controller that is absent for a minute. `make
//! crash-test-slurm` runs them.

use std::time::{Duration, Instant};

use gleaner_proto::v1::*;

use super::{ENDLESS, resumes_whole, with_episodes};
use crate::support::{crash::Settings, lab, skipped::skipped, slurm::Cluster};

/// Kills of the shortest long form.
const LONG: usize = 20;

/// A cluster of one node, in the long form of the crash tests.
async fn start() -> Option<Cluster> {
    if Settings::read().slurm_kills < LONG {
        skipped("takes minutes; make crash-test-slurm runs it");
        return None;
    }
    Cluster::start(1).await
}

/// The shortest limit that Slurm has is a minute.
#[tokio::test]
async fn job_beyond_its_time_limit_resumes_without_losing_a_step_or_an_attempt() {
    let Some(cluster) = start().await else { return };
    let flags = [cluster.flags(), vec!["--slurm-pretrain-options".to_owned(), "--time=1".to_owned()]].concat();
    let flags: Vec<&str> = flags.iter().map(String::as_str).collect();
    let (_server, mut api, _) = lab::with_episodes(&flags).await;
    let id = api.submit(lab::TASK, lab::pretrain(ENDLESS)).await.unwrap().id;
    let first = api.watch_until(&id, |job| job.done >= 1 && !job.engine_id.is_empty()).await;
    resumes_whole(&cluster, &mut api, &first, "TIMEOUT").await;
}

#[tokio::test]
async fn jobs_survive_a_minute_without_the_controller() {
    let Some(mut cluster) = start().await else { return };
    let (_server, mut api, _) = with_episodes(&cluster).await;
    let running = api.submit(lab::TASK, lab::pretrain(ENDLESS)).await.unwrap().id;
    let before = api.watch_until(&running, |job| job.done >= 12).await;
    cluster.kill_controller().await;
    let away = Instant::now();
    let waiting = api.submit(lab::TASK, lab::pretrain(2)).await.unwrap().id;
    let during = api.watch_until(&running, |_| away.elapsed() >= Duration::from_mins(1)).await;
    assert!(during.done > before.done, "{} steps after {}", during.done, before.done);
    let waits = api.watch_until(&waiting, |job| job.waiting.contains("controller")).await;
    assert_eq!((waits.state(), waits.attempt), (JobState::Running, 1), "{}", waits.waiting);
    cluster.start_controller().await;
    let after = api.watch_until(&running, |job| job.done > during.done + 10).await;
    assert_eq!((after.state(), after.attempt, after.engine_id), (JobState::Running, 1, before.engine_id));
    api.jobs.cancel_job(CancelJobRequest { job_id: running.clone() }).await.unwrap();
    assert_eq!(api.watch(&running).await.state(), JobState::Cancelled);
    let ended = api.watch(&waiting).await;
    assert_eq!((ended.state(), ended.attempt), (JobState::Succeeded, 1), "{}", ended.error);
    cluster.until_empty().await;
}
