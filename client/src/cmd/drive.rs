//! `drive`: the simulator as a client of the policy endpoint.

use clap::Args;
use gleaner_client::{Client, DrivePlan, Driven};
use serde_json::{Value, json};

use super::task::sim_config;
use crate::context::Context;
use crate::failure::Result;
use crate::words;

#[derive(Args, Debug)]
pub(crate) struct DriveArgs {
    /// The deployment's name.
    name: String,
    /// Episodes to run.
    #[arg(long, default_value_t = 200, value_parser = clap::value_parser!(u32).range(1..))]
    episodes: u32,
    /// The first episode's seed; the others count up from it.
    #[arg(long, default_value_t = 1_000_000)]
    seed: u64,
    /// Episodes that run at the same time.
    #[arg(long, default_value_t = 4)]
    sessions: usize,
    /// The simulated task.
    #[arg(long, default_value = "pick_cube")]
    task: gleaner_sim::Task,
    /// Camera height and width in pixels, as trained.
    #[arg(long, value_name = "PIXELS")]
    image: Option<u32>,
}

impl DriveArgs {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let plan = DrivePlan {
            deployment: self.name,
            task: self.task,
            config: sim_config(self.image)?,
            episodes: self.episodes,
            seed: self.seed,
            sessions: self.sessions,
        };
        let client = context.client().await?;
        let driven = drive(context, &client, &plan).await?;
        context.output.result(|| Ok(document(&plan, &driven)), || summary(&plan, &driven))?;
        context.output.next("gleaner deployments");
        Ok(())
    }
}

/// Drives with a progress bar and the running count of successes.
pub(crate) async fn drive(context: &Context, client: &Client, plan: &DrivePlan) -> Result<Driven> {
    let bar = context.progress.count(&plan.deployment, u64::from(plan.episodes));
    let mut successes = 0_u32;
    let driven = client
        .drive(plan, |episode| {
            successes += u32::from(episode.success);
            bar.inc(1);
            bar.set_message(format!("{successes} succeeded"));
        })
        .await;
    bar.finish_and_clear();
    Ok(driven?)
}

fn summary(plan: &DrivePlan, driven: &Driven) -> String {
    format!(
        "{} ({}): {}\n{} steps in {}; latency p50 {}, p99 {}",
        plan.deployment,
        driven.policy_id,
        words::success_rate(driven),
        driven.steps(),
        words::duration(driven.wall),
        words::milliseconds(driven.latency(0.5)),
        words::milliseconds(driven.latency(0.99))
    )
}

/// An evaluation as JSON.
pub(crate) fn document(plan: &DrivePlan, driven: &Driven) -> Value {
    let (low, high) = driven.interval();
    json!({
        "deployment": plan.deployment,
        "policy_id": driven.policy_id,
        "episodes": driven.episodes.len(),
        "successes": driven.successes(),
        "success_rate": driven.success_rate(),
        "success_rate_interval_95": [low, high],
        "steps": driven.steps(),
        "seconds": driven.wall.as_secs_f64(),
        "latency_p50_ms": driven.latency(0.5).as_secs_f64() * 1e3,
        "latency_p99_ms": driven.latency(0.99).as_secs_f64() * 1e3,
        "failed_seeds": driven.episodes.iter().filter(|e| !e.success).map(|e| e.seed).collect::<Vec<_>>(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use gleaner_client::DrivenEpisode;
    use std::time::Duration;

    #[test]
    fn an_evaluation_reads_and_has_stable_names() {
        let plan = DrivePlan {
            deployment: "pick@prod".into(),
            task: gleaner_sim::Task::PickCube,
            config: gleaner_sim::SimConfig::default(),
            episodes: 2,
            seed: 5,
            sessions: 1,
        };
        let driven = Driven {
            episodes: vec![
                DrivenEpisode { seed: 5, success: true, steps: 30 },
                DrivenEpisode { seed: 6, success: false, steps: 60 },
            ],
            policy_id: "pol_1".into(),
            latencies: vec![Duration::from_millis(2), Duration::from_millis(4)],
            wall: Duration::from_secs(3),
        };
        assert_eq!(
            summary(&plan, &driven),
            "pick@prod (pol_1): 1 of 2, 50.0 % (95 % interval 9.5 to 90.5)\n\
             90 steps in 3.0 s; latency p50 2.0 ms, p99 4.0 ms"
        );
        let shown = document(&plan, &driven);
        assert_eq!((&shown["successes"], &shown["failed_seeds"]), (&json!(1), &json!([6])));
        assert_eq!(shown["latency_p99_ms"], json!(4.0));
    }
}
