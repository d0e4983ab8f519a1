//! The chain that the options of a pipeline make.

use super::*;
use clap::Parser;
use serde_json::json;

#[derive(Debug, Parser)]
struct Line {
    #[command(flatten)]
    pipeline: PipelineArgs,
}

fn spec(options: &str) -> PipelineSpec {
    Line::try_parse_from(std::iter::once("x").chain(options.split_whitespace())).unwrap().pipeline.spec()
}

#[test]
fn the_chain_ends_at_the_given_stage() {
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
fn a_first_look_is_short_where_no_length_is_given() {
    let steps = |settings: Option<Struct>| {
        let settings = gleaner_core::proto::from_struct(settings);
        (settings["steps"].as_u64(), settings["batch"].as_u64())
    };
    let of = |options: &str| {
        let spec = spec(options);
        (steps(spec.pretrain.unwrap().settings), steps(spec.train.unwrap().settings))
    };
    assert_eq!(of("--quick"), ((Some(1), Some(32)), (Some(800), Some(32))));
    for read in ["--policy finetune", "--scorer ssdf", "--until pretrain", "--initial-weights encoder"] {
        let steps = steps(spec(&format!("--quick {read}")).pretrain.unwrap().settings);
        assert_eq!(steps, (Some(300), Some(32)), "{read}");
    }
    for unread in ["--policy act", "--initial-weights random"] {
        assert_eq!(of(&format!("--quick {unread}")).0, (Some(1), Some(32)), "{unread}");
    }
    assert_eq!(of("--quick --steps 7 --train-batch 8"), ((Some(7), Some(32)), (Some(800), Some(8))));
    let unread = spec("").pretrain.unwrap().settings;
    assert_eq!(steps(unread), (Some(1), Some(32)), "an encoder without a use is no work");
}

#[test]
fn options_that_are_left_out_are_not_sent() {
    assert!(spec("--scorer ssdf").pretrain.unwrap().settings.unwrap().fields.is_empty());
    assert!(spec("").train.unwrap().settings.unwrap().fields.is_empty());
}

#[test]
fn a_dataset_is_selected_by_threshold_or_by_fraction() {
    let kept = |options: &str| (spec(options).beta, spec(options).top_fraction);
    assert_eq!(kept(""), (Some(0.5), None));
    assert_eq!(kept("--normaliser minmax"), (Some(0.9), None));
    assert_eq!(kept("--top 0.1"), (None, Some(0.1)));
    assert_eq!(kept("--top 0.1 --until score"), (None, None));
    assert_eq!(spec("--min-run 5").shape.map(|shape| shape.min_run), Some(5));
    assert_eq!((spec("--until score").shape, spec("--min-run 5 --until score").shape), (None, None));
    let cohorts = |options: &str| spec(options).shape.and_then(|shape| shape.min_expert_auroc);
    let given = ["", "--min-expert-auroc 0", "--min-expert-auroc 0.6 --until dataset"].map(cohorts);
    assert_eq!(given, [Some(gleaner_core::schedule::PipelineSpec::MIN_EXPERT_AUROC), Some(0.0), Some(0.6)]);
    assert!(Line::try_parse_from(["x", "--top", "0.1", "--beta", "0.5"]).is_err());
    let help = Line::try_parse_from(["x", "--help"]).unwrap_err().to_string();
    let of = help.split("--").find(|part| part.starts_with("min-expert-auroc")).unwrap();
    assert!(of.contains("[default: 0.5]") && of.matches("[default").count() == 1, "{of}");
}

#[test]
fn a_scale_has_three_factors() {
    assert!(Line::try_parse_from(["x", "--scale", "1,2"]).unwrap_err().to_string().contains("3 numbers"));
    assert!(Line::try_parse_from(["x", "--scale", "1,two,3"]).is_err());
}

#[test]
fn options_reach_their_stage() {
    let spec = spec(
        "--preset small --steps 7 --lr 0.5 --train-steps 9 --lambda 0.2 --beta 0.8 --seed 3 \
         --expert-cohort a --expert-cohort b --imperfect-cohort c --objective mtp,aa --similarity segment_l2 \
         --scale 1,0.5,2 --policy act --chunk-length 4 --shift-pixels 2 --imperfect-per-expert 3",
    );
    let json = |settings: Option<Struct>| serde_json::Value::Object(gleaner_core::proto::from_struct(settings));
    let scoring = json(spec.scoring.unwrap().settings);
    assert_eq!(scoring, json!({"similarity": "segment_l2", "scale": [1, 0.5, 2]}));
    let pretrain = spec.pretrain.unwrap();
    let expected = json!({
        "preset": "small", "steps": 7, "learning_rate": 0.5, "seed": 3, "objectives": ["mtp", "aa"],
        "shift_pixels": 2,
    });
    assert_eq!(json(pretrain.settings), expected);
    let expected = json!({
        "policy": "act", "preset": "small", "chunk_length": 4, "steps": 9, "lambda": 0.2, "seed": 3,
        "shift_pixels": 2,
    });
    assert_eq!((json(spec.train.unwrap().settings), spec.beta), (expected, Some(0.8)));
    let rule = pretrain.rule.unwrap();
    assert_eq!(rule.imperfect_per_expert, 3.0);
    assert_eq!((rule.expert_cohorts, rule.imperfect_cohorts), (vec!["a".into(), "b".into()], vec!["c".into()]));
}

#[test]
fn a_quick_pipeline_suggests_the_longer_training_first() {
    let jobs =
        |kind: JobKind| [Job { kind: kind.into(), result_id: "pol_1".into(), id: "job_1".into(), ..Job::default() }];
    let deploy = "gleaner deploy NAME@prod --policy pol_1";
    let quick = next(&jobs(JobKind::Train), true, true);
    assert!(quick.starts_with("gleaner train --steps 2000") && quick.ends_with(deploy), "{quick}");
    assert_eq!(next(&jobs(JobKind::Train), true, false), deploy);
    assert_eq!(next(&jobs(JobKind::Score), true, true), "gleaner histogram pol_1");
    assert!(next(&jobs(JobKind::Train), false, true).starts_with("gleaner watch job_1"));
}
