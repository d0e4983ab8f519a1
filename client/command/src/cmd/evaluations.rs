//! `evaluations`, `evaluation`, `report-evaluation`: results of policies, here and elsewhere.

use std::str::FromStr;

use clap::Args;
use gleaner_proto::v1::{Evaluation, GetEvaluationRequest, ReportEvaluationRequest, SeedResult};

use super::policies::evaluation_of;
use crate::context::Context;
use crate::failure::{Result, present};
use crate::table::Column::{Left, Right};
use crate::table::table;
use crate::{json, words};

#[derive(Args, Debug)]
pub(crate) struct EvaluationsArgs {
    /// Id of the policy.
    policy: String,
}

impl EvaluationsArgs {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let client = context.client().await?;
        let reply = client.every_evaluation(&self.policy).await?;
        context.output.result(|| json::value(&reply), || listing(&reply.evaluations))?;
        match reply.evaluations.first() {
            Some(evaluation) => context.output.next(format_args!("gleaner evaluation {}", evaluation.id)),
            None => context.output.next(evaluation_of(context, &client, &self.policy).await),
        }
        Ok(())
    }
}

fn listing(evaluations: &[Evaluation]) -> String {
    let columns = [Left("ID"), Left("SIMULATION"), Right("SEEDS"), Left("SUCCESSES"), Left("BY"), Left("CREATED")];
    let row = |evaluation: &Evaluation| {
        [
            evaluation.id.clone(),
            evaluation.simulation.clone(),
            evaluation.seeds.len().to_string(),
            words::successes(evaluation.successes, evaluation.episodes, (evaluation.low, evaluation.high)),
            if evaluation.job_id.is_empty() { "report".into() } else { evaluation.job_id.clone() },
            words::moment(evaluation.create_time.as_ref()),
        ]
    };
    table(columns, evaluations.iter().map(row))
}

#[derive(Args, Debug)]
pub(crate) struct EvaluationArgs {
    /// Id of the evaluation.
    id: String,
}

impl EvaluationArgs {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let request = GetEvaluationRequest { evaluation_id: self.id };
        let reply = context.client().await?.policies().get_evaluation(request).await?.into_inner();
        let evaluation = present(reply.evaluation.as_ref(), "an evaluation")?;
        context.output.result(|| json::value(&reply), || describe(evaluation))?;
        context.output.next(format_args!("gleaner deploy NAME --policy {}", evaluation.policy_id));
        Ok(())
    }
}

fn describe(evaluation: &Evaluation) -> String {
    let columns = [Right("SEED"), Right("EPISODES"), Right("SUCCESSES"), Right("SHARE"), Right("MEAN STEPS")];
    let row = |seed: &SeedResult| {
        [
            seed.seed.to_string(),
            seed.episodes.to_string(),
            seed.successes.to_string(),
            words::percent(seed.successes.into(), seed.episodes.into()),
            if seed.mean_steps > 0.0 { format!("{:.1}", seed.mean_steps) } else { "-".into() },
        ]
    };
    format!(
        "{} of {} in {}: {}\n\n{}",
        evaluation.id,
        evaluation.policy_id,
        evaluation.simulation,
        words::successes(evaluation.successes, evaluation.episodes, (evaluation.low, evaluation.high)),
        table(columns, evaluation.seeds.iter().map(row))
    )
}

/// One seed's trials: `SEED:EPISODES:SUCCESSES[:MEAN_STEPS]`.
#[derive(Clone, Debug)]
struct Trials(SeedResult);

impl FromStr for Trials {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let wrong = || format!("{text:?}: expected SEED:EPISODES:SUCCESSES[:MEAN_STEPS], such as 0:200:153:31.5");
        let parts: Vec<&str> = text.split(':').collect();
        let (seed, episodes, successes, mean_steps) = match parts[..] {
            [seed, episodes, successes] => (seed, episodes, successes, "0"),
            [seed, episodes, successes, mean_steps] => (seed, episodes, successes, mean_steps),
            _ => return Err(wrong()),
        };
        Ok(Self(SeedResult {
            seed: seed.parse().map_err(|_| wrong())?,
            episodes: episodes.parse().map_err(|_| wrong())?,
            successes: successes.parse().map_err(|_| wrong())?,
            mean_steps: mean_steps.parse().map_err(|_| wrong())?,
        }))
    }
}

#[derive(Args, Debug)]
pub(crate) struct ReportArgs {
    /// Id of the evaluated policy.
    policy: String,
    /// Name of the simulation, such as metaworld/pick-place-v3.
    #[arg(long)]
    simulation: String,
    /// Result of one seed; can be repeated.
    #[arg(long = "result", required = true, value_name = "SEED:EPISODES:SUCCESSES[:MEAN_STEPS]")]
    results: Vec<Trials>,
}

impl ReportArgs {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let request = ReportEvaluationRequest {
            policy_id: self.policy.clone(),
            simulation: self.simulation,
            seeds: self.results.into_iter().map(|trials| trials.0).collect(),
        };
        let reply = context.client().await?.policies().report_evaluation(request).await?.into_inner();
        let evaluation = present(reply.evaluation.as_ref(), "an evaluation")?;
        context.output.result(|| json::value(&reply), || describe(evaluation))?;
        context.output.next(format_args!("gleaner evaluations {}", self.policy));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reported_trials_are_parsed_and_malformed_ones_rejected_with_the_format() {
        let trials: Trials = "3:200:153:31.5".parse().unwrap();
        assert_eq!(trials.0, SeedResult { seed: 3, episodes: 200, successes: 153, mean_steps: 31.5 });
        assert_eq!("0:10:1".parse::<Trials>().unwrap().0.mean_steps, 0.0);
        for text in ["", "1:2", "1:2:x", "1:2:3:4:5", "-1:2:3"] {
            assert!(text.parse::<Trials>().unwrap_err().contains("SEED:EPISODES:SUCCESSES"), "{text}");
        }
    }

    #[test]
    fn an_evaluation_is_shown_seed_by_seed() {
        let seed = |seed, mean_steps| SeedResult { seed, episodes: 4, successes: 3, mean_steps };
        let evaluation = Evaluation {
            id: "evaluation_1".into(),
            policy_id: "pol_1".into(),
            simulation: "pick_cube".into(),
            seeds: vec![seed(0, 30.5), seed(1, 0.0)],
            episodes: 8,
            successes: 6,
            low: 0.4,
            high: 0.9,
            ..Evaluation::default()
        };
        let message = describe(&evaluation);
        assert!(message.starts_with("evaluation_1 of pol_1 in pick_cube: 6 of 8, 75.0 % (95 % interval 40.0 to 90.0)"));
        let last: Vec<&str> = message.lines().last().unwrap().split_whitespace().collect();
        assert_eq!(last, ["1", "4", "3", "75.0", "%", "-"]);
    }
}
