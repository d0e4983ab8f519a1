//! `drive`: the simulator as a client of the policy endpoint.

use std::cmp::Ordering::Equal;
use std::time::Duration;

use clap::Args;
use gleaner_client::robot::ControlReport;
use gleaner_client::{Client, DrivePlan, Driven, DrivenEpisode, RealTime, Recorded};
use gleaner_proto::v1::{ReportEvaluationRequest, SeedResult};
use serde_json::{Value, json};

use super::policies::check_simulated;
use super::task::sim_config;
use crate::context::Context;
use crate::failure::Result;
use crate::words;

#[derive(Args, Debug)]
pub(crate) struct DriveArgs {
    /// Name of the deployment.
    name: String,
    /// Number of episodes. More episodes narrow the confidence interval and take longer.
    #[arg(long, default_value_t = 200, value_parser = clap::value_parser!(u32).range(1..))]
    episodes: u32,
    /// Seed of the first episode; each further one adds 1.
    #[arg(long, default_value_t = 1_000_000)]
    seed: u64,
    /// Number of concurrent sessions. More finish sooner but share the model, which raises latency.
    #[arg(long, default_value_t = 4)]
    sessions: usize,
    /// Name of the simulated task.
    #[arg(long, default_value = "pick_cube")]
    task: gleaner_sim::Task,
    /// Camera height and width in pixels, as in training. Default: 32.
    #[arg(long, value_name = "PIXELS")]
    image: Option<u32>,
    /// Advance the simulator in real time, as a robot would: late actions cause a hold, then a stop. Without this flag
    /// the simulator waits for each action.
    #[arg(long)]
    real_time: bool,
    /// Deadline of a response in milliseconds, 1 to 600000. Default: one control period.
    #[arg(long, value_name = "MS", requires = "real_time", value_parser = clap::value_parser!(u64).range(1..=600_000))]
    deadline_ms: Option<u64>,
    /// Milliseconds for which the robot holds without an action before it stops (0: it stops at once). Default: five
    /// control periods.
    #[arg(long, value_name = "MS", requires = "real_time", value_parser = clap::value_parser!(u64).range(..=600_000))]
    hold_ms: Option<u64>,
    /// Record each run as an episode of the task, labelled success or failure by the simulator.
    #[arg(long)]
    record: bool,
    /// Cohort of the recorded episodes. Default: the name of the deployment.
    #[arg(long, value_name = "TAG", requires = "record")]
    cohort: Option<String>,
    /// Store the result as an evaluation of the policy. Jobs evaluate policies that were trained on the server; this also
    /// evaluates those of other servers.
    #[arg(long, conflicts_with = "real_time")]
    report: bool,
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
            real_time: self.real_time.then(|| RealTime {
                deadline: self.deadline_ms.map(Duration::from_millis),
                hold_for: self.hold_ms.map(Duration::from_millis),
            }),
            record: self.record.then(|| Recorded { cohort: self.cohort.unwrap_or_default() }),
        };
        let client = context.client().await?;
        check_simulated(&client, &plan.deployment, plan.task).await?;
        let driven = drive(context, &client, &plan).await?;
        context.output.result(|| Ok(document(&plan, &driven)), || summary(&plan, &driven))?;
        if self.report {
            client.policies().report_evaluation(evaluation(&plan, &driven)).await?;
            context.output.next(format!("gleaner evaluations {}", driven.policy_id));
            return Ok(());
        }
        match plan.record {
            None => context.output.next("gleaner deployments"),
            // The task has the simulator's name for it, unless its creator chose another.
            Some(_) => context.output.next(format!("gleaner episodes --task {}", plan.task)),
        }
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
            bar.set_message(&format!("{successes} succeeded"));
        })
        .await;
    bar.finish_and_clear();
    Ok(driven?)
}

/// The result as an evaluation of one seed.
fn evaluation(plan: &DrivePlan, driven: &Driven) -> ReportEvaluationRequest {
    #[expect(clippy::cast_precision_loss, reason = "an evaluation has fewer than 2^52 steps")]
    let mean_steps = driven.steps() as f64 / driven.episodes.len().max(1) as f64;
    let (episodes, successes) = (u32::try_from(driven.episodes.len()).unwrap_or(u32::MAX), driven.successes());
    ReportEvaluationRequest {
        policy_id: driven.policy_id.clone(),
        simulation: plan.task.to_string(),
        seeds: vec![SeedResult { seed: plan.seed, episodes, successes, mean_steps }],
    }
}

fn summary(plan: &DrivePlan, driven: &Driven) -> String {
    let steps = format!(
        "{} ({}): {}\n{} steps in {}",
        plan.deployment,
        driven.policy_id,
        words::success_rate(driven),
        driven.steps(),
        words::duration(driven.wall)
    );
    let pace = match &driven.control {
        None => format!(
            "; latency p50 {}, p99 {}",
            words::milliseconds(driven.latency(0.5)),
            words::milliseconds(driven.latency(0.99))
        ),
        Some(control) => format!(", in real time\n{}", control_text(control)),
    };
    let recorded = match (&plan.record, driven.recorded()) {
        (None, _) => String::new(),
        (Some(_), count) => format!("\n{} recorded", words::counted(count, "episode", "episodes")),
    };
    format!("{steps}{pace}{recorded}{}", lowest(driven))
}

/// The step at which the runs departed most from the experts.
fn lowest(driven: &Driven) -> String {
    let scored = driven.episodes.iter().filter_map(|episode| Some((episode, episode.lowest.as_ref()?)));
    let Some((episode, lowest)) = scored.min_by(|(_, a), (_, b)| (a.q, a.w).partial_cmp(&(b.q, b.w)).unwrap_or(Equal))
    else {
        return String::new();
    };
    format!(
        "\nlowest live score: q {:.3} (w {:.3}) at {:.1} s of seed {}, nearest to step {} of {}",
        lowest.q, lowest.w, lowest.seconds, episode.seed, lowest.match_step, lowest.match_episode_id
    )
}

fn control_text(control: &ControlReport) -> String {
    format!(
        "{} ticks: {} acted, {} held, {} rested; {} late, {} missed, {} observations dropped; {} reconnects, {} \
         overruns",
        control.ticks,
        control.acted,
        control.held,
        control.rested,
        control.late,
        control.missed,
        control.dropped,
        control.reconnects,
        control.overruns
    )
}

/// An evaluation as JSON.
pub(crate) fn document(plan: &DrivePlan, driven: &Driven) -> Value {
    let (low, high) = driven.interval();
    let latency_ms = |share| driven.control.is_none().then(|| driven.latency(share).as_secs_f64() * 1e3);
    json!({
        "deployment": plan.deployment,
        "policy_id": driven.policy_id,
        "episodes": driven.episodes.len(),
        "successes": driven.successes(),
        "success_rate": driven.success_rate(),
        "success_rate_interval_95": [low, high],
        "steps": driven.steps(),
        "seconds": driven.wall.as_secs_f64(),
        "latency_p50_ms": latency_ms(0.5),
        "latency_p99_ms": latency_ms(0.99),
        "real_time": driven.control.as_ref().map(counts),
        "episodes_recorded": plan.record.as_ref().map(|_| driven.recorded()),
        "runs": driven.episodes.iter().map(run).collect::<Vec<_>>(),
        "failed_seeds": driven.episodes.iter().filter(|e| !e.success).map(|e| e.seed).collect::<Vec<_>>(),
    })
}

fn run(episode: &DrivenEpisode) -> Value {
    let lowest = episode.lowest.as_ref().map(|lowest| {
        json!({
            "q": lowest.q,
            "w": lowest.w,
            "seconds": lowest.seconds,
            "match_episode_id": lowest.match_episode_id,
            "match_step": lowest.match_step,
        })
    });
    json!({
        "seed": episode.seed,
        "success": episode.success,
        "steps": episode.steps,
        "episode_ids": episode.episode_ids,
        "lowest_score": lowest,
    })
}

fn counts(control: &ControlReport) -> Value {
    json!({
        "ticks": control.ticks,
        "acted": control.acted,
        "held": control.held,
        "rested": control.rested,
        "stops": control.stops,
        "late": control.late,
        "missed": control.missed,
        "dropped": control.dropped,
        "reconnects": control.reconnects,
        "overruns": control.overruns,
        "drains": control.drains,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use gleaner_client::LowestScore;

    #[test]
    fn an_evaluation_is_described_and_has_stable_names() {
        let plan = DrivePlan {
            deployment: "pick@prod".into(),
            task: gleaner_sim::Task::PickCube,
            config: gleaner_sim::SimConfig::default(),
            episodes: 2,
            seed: 5,
            sessions: 1,
            real_time: None,
            record: None,
        };
        let run = |seed, success, steps| DrivenEpisode {
            seed,
            success,
            steps,
            episode_ids: vec![format!("ep_{seed}")],
            lowest: None,
        };
        let mut driven = Driven {
            episodes: vec![run(5, true, 30), run(6, false, 60)],
            policy_id: "pol_1".into(),
            latencies: vec![Duration::from_millis(2), Duration::from_millis(4)],
            wall: Duration::from_secs(3),
            control: None,
        };
        assert_eq!(
            summary(&plan, &driven),
            "pick@prod (pol_1): 1 of 2, 50.0 % (95 % interval 9.5 to 90.5)\n\
             90 steps in 3.0 s; latency p50 2.0 ms, p99 4.0 ms"
        );
        let reported = evaluation(&plan, &driven);
        let seed = SeedResult { seed: 5, episodes: 2, successes: 1, mean_steps: 45.0 };
        assert_eq!((reported.simulation.as_str(), reported.seeds), ("pick_cube", vec![seed]));
        let shown = document(&plan, &driven);
        assert_eq!((&shown["successes"], &shown["failed_seeds"]), (&json!(1), &json!([6])));
        assert_eq!((&shown["latency_p99_ms"], &shown["real_time"]), (&json!(4.0), &Value::Null));

        let lowest = LowestScore { q: 0.25, w: -7.5, seconds: 2.3, match_episode_id: "ep_e".into(), match_step: 11 };
        driven.episodes[1].lowest = Some(lowest);
        let recording = DrivePlan { record: Some(Recorded::default()), ..plan.clone() };
        let message = summary(&recording, &driven);
        let expected = "\n2 episodes recorded\n\
                        lowest live score: q 0.250 (w -7.500) at 2.3 s of seed 6, nearest to step 11 of ep_e";
        assert!(message.ends_with(expected), "{message}");
        let shown = document(&recording, &driven);
        assert_eq!((&shown["episodes_recorded"], &shown["runs"][1]["lowest_score"]["q"]), (&json!(2), &json!(0.25)));

        let mut control = ControlReport::default();
        (control.ticks, control.acted, control.held) = (90, 85, 5);
        driven.control = Some(control);
        let message = summary(&plan, &driven);
        assert!(message.contains("in real time\n90 ticks: 85 acted, 5 held, 0 rested;"), "{message}");
        let shown = document(&plan, &driven);
        assert_eq!((&shown["latency_p99_ms"], &shown["real_time"]["held"]), (&Value::Null, &json!(5)));
    }
}
