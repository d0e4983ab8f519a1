//! Random kills of nodes, workers, the controller and the server under a queue of jobs: every job ends with the result of
//! an undisturbed one, once, and no attempt is counted without a kill of a worker, a node or the controller. Nodes and the
//! controller stay away over further kills. `make crash-test-slurm` is the long form.

use std::time::Duration;

use gleaner_proto::v1::*;
use rand::RngExt as _;

use super::{losses, with_flags};
use crate::support::{api::Api, crash::Settings, lab, slurm::Cluster};

const STEPS: u32 = 30;

/// What was killed, how often.
#[derive(Debug, Default)]
struct Kills {
    nodes: u32,
    controllers: u32,
    /// Of all workers that run.
    workers: u32,
    servers: u32,
}

impl Kills {
    /// Those that can count as an attempt. Slurm cancels the jobs of a controller's last seconds, and those that it was
    /// starting on a node.
    fn that_count(&self) -> u32 {
        self.workers + self.nodes + self.controllers
    }
}

/// What is down until it is repaired.
#[derive(Debug, Default)]
struct Down {
    controller: bool,
    nodes: Vec<String>,
}

impl Down {
    async fn repair(&mut self, cluster: &mut Cluster) {
        self.nodes.drain(..).for_each(|node| cluster.revive(&node));
        if std::mem::take(&mut self.controller) {
            cluster.start_controller().await;
        }
    }
}

/// A job that has not ended, and the kills before it: those that count, and those of the server.
struct Open {
    id: String,
    before: u32,
    servers_before: u32,
}

#[tokio::test]
async fn every_job_ends_once_under_random_kills() {
    let settings = Settings::read();
    let (kills, mut dice) = (settings.slurm_kills, settings.random(7));
    let Some(mut cluster) = Cluster::start(3).await else { return };
    let (mut server, mut api, episodes) = with_flags(&cluster.flags_for_lost_nodes()).await;
    let expected = api.succeed(lab::TASK, lab::pretrain(STEPS)).await;
    let expected_losses = losses(&mut api, &expected.id).await;
    let (mut open, mut results): (Vec<Open>, _) = (Vec::new(), vec![expected.result_id]);
    let (mut killed, mut down) = (Kills::default(), Down::default());
    // Nothing may advance without what is down.
    let patience = Duration::from_secs(if kills < 10 { 3 } else { 15 });
    for kill in 0..kills {
        while open.len() < 3 {
            // A crash of a worker counts as an attempt, and the kills are many.
            let request = SubmitJobRequest {
                task: lab::TASK.into(),
                spec: Some(JobSpec { spec: Some(lab::pretrain(STEPS)) }),
                max_attempts: Some(100),
                ..SubmitJobRequest::default()
            };
            let id = api.jobs.submit_job(request).await.unwrap().into_inner().job.unwrap().id;
            open.push(Open { id, before: killed.that_count(), servers_before: killed.servers });
        }
        let victim = open[dice.random_range(0..open.len())].id.clone();
        let further = super::job(&mut api, &victim).await.job.unwrap().done + dice.random_range(1..=10);
        let passed = move |job: &Job| job.done >= further || gleaner_client::has_ended(job.state());
        let job = match tokio::time::timeout(patience, api.watch_until(&victim, passed)).await {
            Ok(job) => job,
            Err(_) => {
                down.repair(&mut cluster).await;
                api.watch_until(&victim, passed).await
            }
        };
        if dice.random_bool(0.5) {
            down.repair(&mut cluster).await;
        }
        match dice.random_range(0..4) {
            0 if cluster.up().len() > 1 && cluster.up().contains(&job.node) => {
                cluster.kill_node(&job.node).await;
                down.nodes.push(job.node);
                killed.nodes += 1;
            }
            1 if !down.controller => {
                cluster.kill_controller().await;
                down.controller = true;
                killed.controllers += 1;
            }
            2 => {
                cluster.kill_workers();
                killed.workers += 1;
            }
            _ => {
                killed.servers += 1;
                server.kill().await;
                server.start_again().await;
                api = Api::connect(&server).await;
            }
        }
        let mut left = Vec::new();
        for job in open {
            let now = super::job(&mut api, &job.id).await.job.unwrap();
            if gleaner_client::has_ended(now.state()) {
                results.push(check(&mut api, &now, &job, &killed, &expected_losses).await);
            } else {
                left.push(job);
            }
        }
        open = left;
        eprintln!("kill {} of {kills}: {} jobs done", kill + 1, results.len() - 1);
    }
    down.repair(&mut cluster).await;
    for job in open {
        let ended = api.watch(&job.id).await;
        results.push(check(&mut api, &ended, &job, &killed, &expected_losses).await);
    }
    eprintln!("{} jobs after {killed:?}", results.len() - 1);
    let jobs =
        api.jobs.list_jobs(ListJobsRequest { page_size: 1000, ..Default::default() }).await.unwrap().into_inner();
    let mut listed: Vec<_> = jobs.jobs.into_iter().map(|job| job.result_id).collect();
    listed.sort();
    results.sort();
    assert_eq!(listed, results, "every job that was submitted has one result, of its own");
    results.dedup();
    assert_eq!(listed.len(), results.len());
    assert_eq!(api.episodes().await, episodes, "no episode is lost");
    cluster.until_empty().await;
}

/// The result of a job that ended.
async fn check(api: &mut Api, job: &Job, open: &Open, killed: &Kills, expected: &[(u64, f64)]) -> String {
    assert_eq!(job.state(), JobState::Succeeded, "{}: {}", job.id, job.error);
    assert_eq!(losses(api, &job.id).await, expected, "{}", job.id);
    let log = super::job(api, &job.id).await.log;
    let kills = killed.that_count() - open.before;
    assert!(job.attempt <= 1 + kills, "{} attempts, {kills} kills that count: {log}", job.attempt);
    // The steps of a lost worker are removed when its job is queued again. Only a report whose answer a kill of the server
    // has lost is sent twice, so a return to an earlier step without one is of a second worker.
    let rows = api.metric(&job.id, "loss").await;
    assert!(rows.iter().all(|row| expected.contains(row)), "{}: {rows:?}", job.id);
    let again = rows.windows(2).filter(|pair| pair[1].0 <= pair[0].0).count();
    let kills = killed.servers - open.servers_before;
    assert!(again <= kills as usize, "{}: {again} returns to an earlier step after {kills} kills: {rows:?}", job.id);
    job.result_id.clone()
}
