//! Random kills of nodes, workers, the controller and the server under a queue of jobs: every job ends with the result of
//! an undisturbed one, and no attempt is counted that no job caused. `make crash-test-slurm` is the long form.

use gleaner_proto::v1::*;
use rand::RngExt as _;

use super::{losses, with_episodes};
use crate::support::{api::Api, crash::Settings, lab, slurm::Cluster};

const STEPS: u32 = 30;

#[tokio::test]
async fn every_job_ends_once_under_random_kills() {
    let settings = Settings::read();
    let (kills, mut dice) = (settings.slurm_kills, settings.random(7));
    let Some(mut cluster) = Cluster::start(3).await else { return };
    let (mut server, mut api, episodes) = with_episodes(&cluster).await;
    let expected = api.succeed(lab::TASK, lab::pretrain(STEPS)).await;
    let expected_losses = losses(&mut api, &expected.id).await;
    let mut open: Vec<String> = Vec::new();
    let mut done = 0;
    for kill in 0..kills {
        while open.len() < 3 {
            // A crash of a worker counts as an attempt, and the kills are many.
            let request = SubmitJobRequest {
                task: lab::TASK.into(),
                spec: Some(JobSpec { spec: Some(lab::pretrain(STEPS)) }),
                max_attempts: Some(100),
                ..SubmitJobRequest::default()
            };
            open.push(api.jobs.submit_job(request).await.unwrap().into_inner().job.unwrap().id);
        }
        let victim = open[dice.random_range(0..open.len())].clone();
        let further = super::job(&mut api, &victim).await.job.unwrap().done + dice.random_range(1..=10);
        let passed = |job: &Job| job.done >= further || gleaner_client::has_ended(job.state());
        let job = api.watch_until(&victim, passed).await;
        match dice.random_range(0..4) {
            0 if cluster.up().contains(&job.node) => {
                cluster.kill_node(&job.node).await;
                cluster.revive(&job.node);
            }
            1 => {
                cluster.kill_controller().await;
                cluster.start_controller().await;
            }
            2 => cluster.kill_workers(),
            _ => {
                server.kill().await;
                server.start_again().await;
                api = Api::connect(&server).await;
            }
        }
        let mut left = Vec::new();
        for id in open {
            let job = super::job(&mut api, &id).await.job.unwrap();
            if gleaner_client::has_ended(job.state()) {
                done += 1;
                check(&mut api, &job, &expected_losses).await;
            } else {
                left.push(id);
            }
        }
        open = left;
        eprintln!("kill {} of {kills}: {done} jobs done", kill + 1);
    }
    for id in open {
        let job = api.watch(&id).await;
        check(&mut api, &job, &expected_losses).await;
    }
    assert_eq!(api.episodes().await, episodes, "no episode is lost");
    cluster.until_empty().await;
}

async fn check(api: &mut Api, job: &Job, expected: &[(u64, f64)]) {
    assert_eq!(job.state(), JobState::Succeeded, "{}: {}", job.id, job.error);
    assert_eq!(losses(api, &job.id).await, expected, "{}", job.id);
}
