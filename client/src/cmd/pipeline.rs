//! `pipeline`: pretrain, score, filter, train, evaluate as one chain of jobs. Its options are the schedules' too.

use clap::{Args, ValueEnum};
use gleaner_proto::v1::{Job, PipelineSpec, SubmitPipelineRequest, TrainSpec};

use super::evaluate::TrialArgs;
use super::plan::{self, PolicyArgs, PretrainArgs, ScoringArgs};
use super::submit::{SubmitArgs, after, outcome};
use super::{follow, jobs};
use crate::context::Context;
use crate::failure::Result;
use crate::json;

/// How far a pipeline goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, ValueEnum)]
enum Until {
    Pretrain,
    Score,
    Dataset,
    Train,
    Evaluate,
}

/// What a pipeline does.
#[derive(Args, Clone, Debug)]
pub(crate) struct PipelineArgs {
    #[command(flatten)]
    pretrain: PretrainArgs,
    /// The last stage.
    #[arg(long, value_enum, default_value = "train")]
    until: Until,
    /// Keep segments with a quality above this threshold, 0 to 1.
    #[arg(long, default_value_t = 0.9, allow_negative_numbers = true)]
    beta: f64,
    /// Instead of --beta, keep this fraction of the segments, the best ones.
    #[arg(long, value_name = "FRACTION", conflicts_with = "beta")]
    top: Option<f64>,
    #[command(flatten)]
    scoring: ScoringArgs,
    #[command(flatten)]
    policy: PolicyArgs,
    /// Optimiser steps of the policy's training.
    #[arg(long, value_name = "STEPS")]
    train_steps: Option<u32>,
    /// Segments per step of the policy's training.
    #[arg(long, value_name = "BATCH")]
    train_batch: Option<u32>,
    /// Learning rate of the policy's training.
    #[arg(long, value_name = "LR")]
    train_lr: Option<f64>,
    #[command(flatten)]
    trials: TrialArgs,
}

impl PipelineArgs {
    pub(crate) fn spec(&self) -> Result<PipelineSpec> {
        let pretrain = self.pretrain.spec();
        let (seed, device) = (self.pretrain.seed(), self.pretrain.device());
        let train = || {
            let optim = plan::optim(self.train_steps, self.train_batch, self.train_lr);
            TrainSpec {
                augmentation: self.pretrain.augmentation(),
                preset: pretrain.preset,
                segment_length: pretrain.segment_length,
                ..self.policy.spec(optim, seed, device)
            }
        };
        let (scored, selected) = (self.until >= Until::Score, self.until >= Until::Dataset);
        Ok(PipelineSpec {
            score: scored,
            scoring: if scored { Some(self.scoring.spec(seed, device)?) } else { None },
            beta: (selected && self.top.is_none()).then_some(self.beta),
            top_fraction: self.top.filter(|_| selected),
            train: (self.until >= Until::Train).then(train),
            evaluate: (self.until >= Until::Evaluate).then(|| self.trials.spec(device)),
            pretrain: Some(pretrain),
        })
    }
}

#[derive(Args, Debug)]
pub(crate) struct PipelineCommand {
    /// Name or id of the task. Default: the only task of the server.
    #[arg(long)]
    task: Option<String>,
    #[command(flatten)]
    pipeline: PipelineArgs,
    #[command(flatten)]
    submit: SubmitArgs,
}

impl PipelineCommand {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let client = context.client().await?;
        let request = SubmitPipelineRequest {
            task: context.task(&client, self.task.as_deref()).await?,
            pipeline: Some(self.pipeline.spec()?),
            priority: self.submit.priority,
        };
        let mut reply = client.jobs().submit_pipeline(request).await?.into_inner();
        if self.submit.wait {
            for job in &mut reply.jobs {
                *job = follow::to_success(context, &client, &job.id).await?;
                context.output.note(outcome(job));
            }
        }
        let text = || {
            let mut text = jobs::listing(&reply.jobs);
            if !reply.dataset_id.is_empty() {
                text.push_str(&format!("\ndataset {}", reply.dataset_id));
            }
            text
        };
        context.output.result(|| json::value(&reply), text)?;
        context.output.next(next(&reply.jobs, self.submit.wait));
        Ok(())
    }
}

fn next(submitted: &[Job], waited: bool) -> String {
    match submitted.last() {
        Some(last) if waited => after(last),
        Some(last) => format!("gleaner watch {} (the last of the chain)", last.id),
        None => "gleaner jobs".into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;
    use gleaner_proto::v1::{Objective, PolicyKind, Preset, Similarity};

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        pipeline: PipelineArgs,
    }

    fn spec(options: &str) -> PipelineSpec {
        Line::try_parse_from(std::iter::once("x").chain(options.split_whitespace())).unwrap().pipeline.spec().unwrap()
    }

    #[test]
    fn the_chain_ends_where_it_is_told() {
        let stages = |until: &str| {
            let spec = spec(&format!("--until {until}"));
            (spec.score, spec.beta.is_some(), spec.train.is_some(), spec.evaluate.is_some())
        };
        assert_eq!(stages("pretrain"), (false, false, false, false));
        assert_eq!(stages("score"), (true, false, false, false));
        assert_eq!(stages("dataset"), (true, true, false, false));
        assert_eq!(stages("train"), (true, true, true, false));
        assert_eq!(stages("evaluate"), (true, true, true, true));
    }

    #[test]
    fn what_is_not_given_is_left_to_the_server() {
        let optim = spec("").pretrain.unwrap().optim.unwrap();
        assert_eq!((optim.steps, optim.batch, optim.learning_rate), (None, None, None));
    }

    #[test]
    fn a_dataset_is_by_threshold_or_by_part() {
        let kept = |options: &str| (spec(options).beta, spec(options).top_fraction);
        assert_eq!(kept(""), (Some(0.9), None));
        assert_eq!(kept("--top 0.1"), (None, Some(0.1)));
        assert_eq!(kept("--top 0.1 --until score"), (None, None));
        assert!(Line::try_parse_from(["x", "--top", "0.1", "--beta", "0.5"]).is_err());
    }

    #[test]
    fn a_scale_has_three_factors() {
        let parsed = Line::try_parse_from(["x", "--scale", "1,2"]).unwrap().pipeline.spec();
        assert!(parsed.unwrap_err().to_string().contains("three factors"));
        assert!(Line::try_parse_from(["x", "--scale", "1,two,3"]).is_err());
    }

    #[test]
    fn options_reach_their_stage() {
        let spec = spec(
            "--preset small --steps 7 --lr 0.5 --train-steps 9 --lambda 0.2 --beta 0.8 --seed 3 \
             --expert-cohort a --expert-cohort b --imperfect-cohort c --objective mtp,aa --similarity segment_l2 \
             --scale 1,0.5,2 --policy act --chunk-length 4 --shift-pixels 2 --imperfect-per-expert 3",
        );
        let scoring = spec.scoring.unwrap();
        assert_eq!(scoring.similarity(), Similarity::SegmentL2);
        assert_eq!(scoring.modality_scale.map(|scale| (scale.proprioception, scale.action)), Some((0.5, 2.0)));
        let (pretrain, train) = (spec.pretrain.unwrap(), spec.train.unwrap());
        assert_eq!((pretrain.preset(), pretrain.seed, train.seed), (Preset::Small, 3, 3));
        assert_eq!((pretrain.optim.unwrap().steps, train.optim.unwrap().steps), (Some(7), Some(9)));
        assert_eq!((pretrain.optim.unwrap().learning_rate, train.lambda, spec.beta), (Some(0.5), Some(0.2), Some(0.8)));
        assert_eq!(pretrain.objectives, [i32::from(Objective::Mtp), i32::from(Objective::Aa)]);
        assert_eq!(pretrain.augmentation.map(|images| images.shift_pixels), Some(2));
        assert_eq!((train.policy(), train.act.unwrap().chunk_length), (PolicyKind::Act, Some(4)));
        let rule = pretrain.rule.unwrap();
        assert_eq!(rule.imperfect_per_expert, 3.0);
        assert_eq!((rule.expert_cohorts, rule.imperfect_cohorts), (vec!["a".into(), "b".into()], vec!["c".into()]));
    }
}
