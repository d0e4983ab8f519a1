//! Jobs on a real Slurm of several nodes: the same results as on the server's machine, and failures of nodes, of the
//! controller, of the server and of submissions.

mod bare;
mod crash;
mod grid;
mod minutes;
mod nodes;
mod place;
mod ranks;

use gleaner_client::Client;
use gleaner_proto::v1::*;

use crate::support::{
    api::Api,
    lab,
    server::TestServer,
    slurm::Cluster,
    wait::{until, within},
};

/// More steps than a test lasts.
const ENDLESS: u32 = 1_000_000;

/// A server with episodes whose jobs run on the cluster.
async fn with_episodes(cluster: &Cluster) -> (TestServer, Api, Vec<Episode>) {
    with_flags(&cluster.flags()).await
}

async fn with_flags(flags: &[String]) -> (TestServer, Api, Vec<Episode>) {
    lab::with_episodes(&flags.iter().map(String::as_str).collect::<Vec<_>>()).await
}

/// The last value of each step: steps after the last checkpoint run and are reported again.
async fn losses(api: &mut Api, job: &str) -> Vec<(u64, f64)> {
    let by_step: std::collections::BTreeMap<u64, f64> = api.metric(job, "loss").await.into_iter().collect();
    by_step.into_iter().collect()
}

/// The steps of the losses, as they were reported. Those after the last checkpoint are removed when the job is queued again,
/// so an attempt that begins elsewhere than at its step leaves a gap or repeats some.
async fn steps(api: &mut Api, job: &str) -> Vec<u64> {
    api.metric(job, "loss").await.into_iter().map(|(step, _)| step).collect()
}

/// Waits until a job runs again after Slurm has ended `first` in this state, without a lost step or attempt, and cancels it.
async fn resumes_whole(cluster: &Cluster, api: &mut Api, first: &Job, state: &str) {
    let mut furthest = 0;
    let resumed = api
        .watch_until(&first.id, |job| {
            let again = job.engine_id != first.engine_id && !job.engine_id.is_empty() && job.done > furthest;
            furthest = furthest.max(job.done);
            again
        })
        .await;
    assert_eq!((resumed.state(), resumed.attempt), (JobState::Running, 1), "{}", resumed.error);
    let ended = cluster.jobs().await.into_iter().find(|job| job.id == first.engine_id);
    assert_eq!(ended.map(|job| job.state).as_deref(), Some(state));
    let steps = steps(api, &first.id).await;
    assert!(steps.len() as u64 >= resumed.done);
    assert_eq!(steps, (1..=steps.len() as u64).collect::<Vec<_>>(), "no step is lost or repeated");
    api.jobs.cancel_job(CancelJobRequest { job_id: first.id.clone() }).await.unwrap();
    assert_eq!(api.watch(&first.id).await.state(), JobState::Cancelled);
    cluster.until_empty().await;
}

async fn job(api: &mut Api, id: &str) -> GetJobResponse {
    api.jobs.get_job(GetJobRequest { job_id: id.to_owned() }).await.unwrap().into_inner()
}

/// Runs a pretraining of two steps on the cluster by a client with TLS, which must succeed; returns its losses.
async fn pretrain(client: &Client) -> Vec<(u64, f64)> {
    let request = SubmitJobRequest {
        task: lab::TASK.into(),
        spec: Some(JobSpec { spec: Some(lab::pretrain(2)) }),
        ..SubmitJobRequest::default()
    };
    let id = client.jobs().submit_job(request).await.unwrap().into_inner().job.unwrap().id;
    let request = WatchJobRequest { job_id: id.clone() };
    let mut events = client.jobs().watch_job(request).await.unwrap().into_inner();
    let mut ended = Job::default();
    let watching = async {
        while let Some(event) = events.message().await.unwrap() {
            ended = event.job.unwrap();
        }
    };
    within("the job ends", watching).await;
    let (state, engine, attempt) = (ended.state(), ended.engine.as_str(), ended.attempt);
    assert_eq!((state, engine, attempt), (JobState::Succeeded, "slurm", 1), "{}", ended.error);
    let metrics = client.jobs().list_metrics(ListMetricsRequest { job_id: id }).await.unwrap().into_inner().metrics;
    metrics.into_iter().filter(|metric| metric.name == "loss").map(|metric| (metric.step, metric.value)).collect()
}

#[tokio::test]
async fn job_on_slurm_equals_a_local_one() {
    let Some(cluster) = Cluster::start(2).await else { return };
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    let (mut server, mut api, episodes) = lab::over(&data).await;
    let local = api.succeed(lab::TASK, lab::pretrain(8)).await;
    let local_run = api.succeed(lab::TASK, lab::score(&local.result_id)).await.result_id;
    assert_eq!((local.engine.as_str(), local.node.as_str()), ("local", ""));
    assert!(server.stop().await);

    let flags = cluster.flags();
    let server = TestServer::start_over(&data, &flags.iter().map(String::as_str).collect::<Vec<_>>()).await;
    let mut api = Api::connect(&server).await;
    let remote = api.succeed(lab::TASK, lab::pretrain(8)).await;
    let remote_run = api.succeed(lab::TASK, lab::score(&remote.result_id)).await.result_id;
    assert_eq!(api.metric(&remote.id, "loss").await, api.metric(&local.id, "loss").await);
    for episode in &episodes {
        let expected = api.episode_scores(&local_run, &episode.id).await;
        assert_eq!(api.episode_scores(&remote_run, &episode.id).await, expected);
    }
    assert!(remote.engine == "slurm" && remote.node.starts_with("node") && remote.waiting.is_empty(), "{remote:?}");
    assert!(cluster.jobs().await.iter().any(|job| job.id == remote.engine_id), "{remote:?}");
    let log = until("the log has the worker's output", async || {
        let log = job(&mut api, &remote.id).await.log;
        log.contains("working").then_some(log)
    });
    assert!(log.await.contains("gleaner-server: attempt 1 of 3 begins"));
    cluster.until_empty().await;
}

#[tokio::test]
async fn job_resumes_on_another_node_after_its_node_is_killed() {
    const STEPS: u32 = 40;
    let Some(mut cluster) = Cluster::start(2).await else { return };
    let (_server, mut api, _) = with_flags(&cluster.flags_for_lost_nodes()).await;
    let expected = api.succeed(lab::TASK, lab::pretrain(STEPS)).await;
    let killed = api.submit(lab::TASK, lab::pretrain(STEPS)).await.unwrap();
    let running = api.watch_until(&killed.id, |job| job.done >= 7 && !job.node.is_empty()).await;
    cluster.kill_node(&running.node).await;
    let ended = api.watch(&killed.id).await;
    assert_eq!((ended.state(), ended.attempt), (JobState::Succeeded, 1), "a lost node is no attempt: {}", ended.error);
    assert!(ended.node != running.node && ended.engine_id != running.engine_id, "{ended:?}");
    // A step above 5 is reported only after the checkpoint of step 5 is saved: a start from the beginning repeats steps.
    let once: Vec<u64> = (1..=u64::from(STEPS)).collect();
    assert_eq!(steps(&mut api, &killed.id).await, once, "the job resumed from its checkpoint");
    assert_eq!(losses(&mut api, &killed.id).await, losses(&mut api, &expected.id).await);
}

/// The running job ends and the next one waits with the reason; it runs once the controller is back.
#[tokio::test]
async fn jobs_survive_the_absence_of_the_controller() {
    let Some(mut cluster) = Cluster::start(1).await else { return };
    let (_server, mut api, _) = with_episodes(&cluster).await;
    let running = api.submit(lab::TASK, lab::pretrain(40)).await.unwrap();
    // Past a checkpoint: the controller may cancel a job that it started just before its end.
    api.watch_until(&running.id, |job| job.done >= 12).await;
    cluster.kill_controller().await;
    let waiting = api.submit(lab::TASK, lab::pretrain(2)).await.unwrap();
    let ended = api.watch(&running.id).await;
    assert_eq!((ended.state(), ended.attempt), (JobState::Succeeded, 1), "{}", ended.error);
    let waits = api.watch_until(&waiting.id, |job| job.waiting.contains("controller")).await;
    assert_eq!((waits.state(), waits.attempt), (JobState::Running, 1), "{}", waits.waiting);
    cluster.start_controller().await;
    let ended = api.watch(&waiting.id).await;
    assert_eq!((ended.state(), ended.attempt), (JobState::Succeeded, 1), "{}", ended.error);
    cluster.until_empty().await;
}

#[tokio::test]
async fn workers_continue_while_the_server_is_down() {
    const STEPS: u32 = 60;
    let Some(cluster) = Cluster::start(1).await else { return };
    let (mut server, mut api, _) = with_episodes(&cluster).await;
    let expected = api.succeed(lab::TASK, lab::pretrain(STEPS)).await;
    let job = api.submit(lab::TASK, lab::pretrain(STEPS)).await.unwrap();
    let first = api.watch_until(&job.id, |job| job.done >= 5 && !job.node.is_empty()).await;
    server.kill().await;
    server.start_again().await;
    let mut api = Api::connect(&server).await;
    let after_kill = api.watch_until(&job.id, |job| job.done > first.done + 5).await;
    assert_eq!((after_kill.attempt, &after_kill.engine_id), (1, &first.engine_id));
    assert!(server.stop().await, "a stop on request is a success");
    server.start_again().await;

    let mut api = Api::connect(&server).await;
    let ended = api.watch(&job.id).await;
    assert_eq!((ended.state(), ended.attempt), (JobState::Succeeded, 1), "{}", ended.error);
    assert_eq!(ended.engine_id, first.engine_id, "the same worker has ended it");
    assert_eq!(losses(&mut api, &job.id).await, losses(&mut api, &expected.id).await);
}

#[tokio::test]
async fn cancelled_jobs_leave_slurm_whether_they_wait_or_run() {
    let Some(cluster) = Cluster::start(1).await else { return };
    let (_server, mut api, _) = with_episodes(&cluster).await;
    let running = api.submit(lab::TASK, lab::pretrain(100_000)).await.unwrap();
    api.watch_until(&running.id, |job| job.done >= 1).await;
    let waiting = api.submit(lab::TASK, lab::pretrain(100_000)).await.unwrap();
    let waits =
        api.watch_until(&waiting.id, |job| !job.engine_id.is_empty() && job.waiting.contains("Resources")).await;
    api.jobs.cancel_job(CancelJobRequest { job_id: waiting.id.clone() }).await.unwrap();
    assert_eq!(api.watch(&waiting.id).await.state(), JobState::Cancelled);
    until("Slurm has cancelled the waiting job", async || {
        let jobs = cluster.jobs().await;
        jobs.iter().any(|job| job.id == waits.engine_id && job.state == "CANCELLED").then_some(())
    })
    .await;
    api.jobs.cancel_job(CancelJobRequest { job_id: running.id.clone() }).await.unwrap();
    assert_eq!(api.watch(&running.id).await.state(), JobState::Cancelled);
    cluster.until_empty().await;
}

/// Both processes have the token of the attempt; the first one that calls is its worker.
#[tokio::test]
async fn job_that_slurm_starts_twice_is_done_once() {
    let Some(cluster) = Cluster::start(2).await else { return };
    let (_server, mut api, _) = with_episodes(&cluster).await;
    cluster.replace(
        "sbatch",
        "script=$(cat)\nprintf '%s\\n' \"$script\" | REAL \"$@\"\nprintf '%s\\n' \"$script\" | REAL \"$@\" >&2",
    );
    let twice = api.succeed(lab::TASK, lab::pretrain(20)).await;
    assert_eq!(twice.attempt, 1);
    assert_eq!(steps(&mut api, &twice.id).await, (1..=20).collect::<Vec<_>>(), "one process reported");
    cluster.until_empty().await;
    let jobs = cluster.jobs().await;
    assert_eq!(jobs.len(), 2, "{jobs:?}");
    assert!(jobs.iter().any(|job| job.state == "FAILED"), "the other process was rejected: {jobs:?}");
}
