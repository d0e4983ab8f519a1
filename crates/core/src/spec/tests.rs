//! Specs from settings and from the forms of earlier versions.

use serde_json::{Value, json};

use super::*;
use crate::kinds::Family;
use crate::schema::Values;

fn values(json: Value) -> Values {
    json.as_object().unwrap().clone()
}

#[test]
fn empty_settings_are_the_defaults() {
    assert_eq!(PretrainSpec::from_values(&Values::new()).unwrap(), PretrainSpec::default());
    assert_eq!(ScoreSpec::from_values(&Values::new()).unwrap(), ScoreSpec::default());
    assert_eq!(TrainSpec::from_values(&Values::new()).unwrap(), TrainSpec::default());
    assert_eq!(EvaluateSpec::from_values(&Values::new()).unwrap(), EvaluateSpec::default());
    assert_eq!(PretrainSpec::default().objectives, ["mtp", "tr", "aa"]);
}

#[test]
fn settings_round_trip() {
    let train = values(json!({"policy": "act", "chunk_length": 4, "lambda": 0.2, "batch": 8, "seed": 7}));
    let spec = TrainSpec::from_values(&train).unwrap();
    assert_eq!(TrainSpec::from_values(&spec.values()).unwrap(), spec);
    let stored = serde_json::to_string(&spec).unwrap();
    assert_eq!(serde_json::from_str::<TrainSpec>(&stored).unwrap(), spec);
    assert_eq!(spec.policy.settings["chunk_length"], json!(4));
}

#[test]
fn defaults_of_the_optimiser_that_depend_on_the_policy_are_those_of_the_policy() {
    let spec = |value: Value| TrainSpec::from_values(&values(value)).unwrap();
    let of = |spec: &TrainSpec| (spec.optim.learning_rate, spec.optim.stretch);
    assert_eq!(of(&spec(json!({"policy": "tf_bc"}))), (0.002, 1));
    assert_eq!(of(&spec(json!({"policy": "bc"}))), (0.001, 8));
    let given = spec(json!({"policy": "tf_bc", "learning_rate": 0.5, "stretch": 3}));
    assert_eq!(of(&given), (0.5, 3));
    // They are in one place of a spec, so that a change there is the whole change.
    assert!(!given.policy.settings.contains_key("learning_rate"));
    assert_eq!(TrainSpec::from_values(&given.values()).unwrap(), given);
    // Versions that stored neither had these.
    let stored: TrainSpec = serde_json::from_value(json!({"policy": "tf_bc"})).unwrap();
    assert_eq!(of(&stored), (0.001, 8));
}

#[test]
fn a_setting_of_another_kind_is_rejected() {
    let message = |value: Value| TrainSpec::from_values(&values(value)).unwrap_err().to_string();
    let found = message(json!({"policy": "bc", "chunk_length": 3}));
    assert_eq!(
        found,
        "chunk_length: has no effect: the policy bc does not use it, only act, flow, diffusion; leave it out"
    );
    assert!(message(json!({"chunk_lenght": 3})).starts_with("chunk_lenght: unknown setting; supported: policy, "));
    assert!(message(json!({"policy": "magic"})).contains("supported: bc, "));
    let scoring = values(json!({"scorer": "classifier", "similarity": "last_l2"}));
    assert!(ScoreSpec::from_values(&scoring).unwrap_err().to_string().starts_with("similarity: has no effect"));
}

#[test]
fn a_training_states_the_history_of_its_policy() {
    let history = |policy: serde_json::Value| TrainSpec::from_values(&values(policy)).unwrap().history_steps();
    assert_eq!(history(json!({"policy": "bc"})), Some(0));
    assert_eq!(history(json!({"policy": "act", "history_steps": 3})), Some(3));
    assert_eq!(history(json!({"policy": "tf_bc"})), Some(6));
    assert_eq!(history(json!({"policy": "tf_bc", "segment_length": 0})), Some(0));
    assert_eq!(history(json!({"policy": "perceptron"})), Some(0));
    assert_eq!(history(json!({"policy": "finetune"})), None, "that of its encoder");
}

#[test]
fn objectives_keep_the_order_of_their_list() {
    let spec = PretrainSpec::from_values(&values(json!({"objectives": ["aa", "mtp"]}))).unwrap();
    assert_eq!(spec.objectives, ["mtp", "aa"]);
}

#[test]
fn specs_of_earlier_versions_are_read() {
    let pretrain: PretrainSpec = serde_json::from_value(json!({
        "model": {"preset": "small", "segment_length": 3}, "objectives": ["mtp"],
        "augmentation": {"shift_pixels": 2, "brightness": 0.0, "contrast": 0.0},
        "optim": {"steps": 9, "batch": 4}, "seed": 5, "checkpoint_every": 3, "device": "cpu", "threads": null,
    }))
    .unwrap();
    assert_eq!((pretrain.model.preset, pretrain.model.segment_length), (Preset::Small, 3));
    assert_eq!((pretrain.optim.steps, pretrain.run.seed, pretrain.augmentation.shift_pixels), (9, 5, 2));
    let train: TrainSpec = serde_json::from_value(json!({
        "policy": "act", "model": {"preset": "base", "segment_length": 6}, "lambda": 0.3, "history_dropout": 0.5,
        "act": {"chunk_length": 5, "kl_weight": 1.0, "latent_size": 8}, "threads": 2,
    }))
    .unwrap();
    let expected = json!({
        "preset": "base", "image_encoder": "keypoints", "keypoint_gain": 1.0, "image_weights": "",
        "shift_pixels": 0, "brightness": 0.0, "contrast": 0.0, "proprioception_noise": 0.0, "proprioception_dropout": 0.0,
        "initial_weights": "random", "history_steps": 0, "fresh_share": 0.0, "history_dropout": 0.5, "hidden_history": "steps", "image_tokens": "embedding",
        "chunk_length": 5, "chunk_network": "transformer", "chunk_execution": "ensembled", "execute_length": 5, "kl_weight": 1.0, "latent_size": 8,
    });
    assert_eq!(Value::Object(train.policy.settings.clone()), expected);
    assert_eq!(train.augmentation(), Ok(Augmentation::default()));
    let train: TrainSpec = serde_json::from_value(json!({"optim": {"steps": 9}})).unwrap();
    assert_eq!((train.policy.name.as_str(), train.augmentation()), ("finetune", Ok(Augmentation::default())));
    assert_eq!((train.validation_share, TrainSpec::default().validation_share), (0.0, 0.05));
    assert_eq!((train.switch_weight, train.dropout), (1.0, 0.0));
    for augmentation in
        [json!({"shift_pixels": 4, "contrast": 0.2}), json!({"augmentation": {"shift_pixels": 4, "contrast": 0.2}})]
    {
        let mut stored = values(json!({"policy": "bc", "steps": 9}));
        stored.extend(values(augmentation));
        let train: TrainSpec = serde_json::from_value(Value::Object(stored)).unwrap();
        let read = train.augmentation().unwrap();
        assert_eq!((read.shift_pixels, read.contrast, read.proprioception_dropout), (4, 0.2, 0.0), "as it was stored");
    }
    let bc = TrainSpec::default();
    assert_eq!((bc.policy.name.as_str(), bc.augmentation().unwrap().shift_pixels), ("bc", 2));
    let history = |spec: &TrainSpec| ["action_token", "history_dropout"].map(|name| spec.policy.settings[name].clone());
    let tf_bc: TrainSpec = serde_json::from_value(json!({"policy": "tf_bc", "steps": 9})).unwrap();
    assert_eq!(
        (history(&tf_bc), tf_bc.augmentation()),
        ([json!("proprioception"), json!(0.5)], Ok(Augmentation::default()))
    );
    assert_eq!(tf_bc.weighting.settings["lambda"], json!(0.1));
    let tf_bc = TrainSpec::from_values(&values(json!({"policy": "tf_bc"}))).unwrap();
    assert_eq!(tf_bc.weighting.settings["lambda"], json!(0.3));
    assert_eq!((history(&tf_bc), tf_bc.augmentation()), ([json!("image"), json!(0.9)], bc.augmentation()));
    let score: ScoreSpec = serde_json::from_value(json!({
        "scorer": "ssdf", "similarity": "last_cosine", "feature_scale": "plain", "yardstick": "none",
        "normaliser": "min_max", "modality_scale": [1.0, 0.5, 2.0], "seed": 3, "device": "cpu", "threads": null,
    }))
    .unwrap();
    let expected = json!({"similarity": "last_cosine", "feature_scale": "plain", "local_scale": false, "scale": [1.0, 0.5, 2.0], "lookahead": 0.0, "lead_in": 0.0, "earliness": 0.0, "progress": "furthest"});
    assert_eq!((Value::Object(score.scorer.settings), score.normaliser), (expected, NormaliserKind::MinMax));
    let first: ScoreSpec = serde_json::from_value(json!({"similarity": "last_l2"})).unwrap();
    assert_eq!((first.scorer.name.as_str(), &first.scorer.settings["similarity"]), ("ssdf", &json!("last_l2")));
    let of = |scorer: &str| -> ScoreSpec {
        let stored = json!({"scorer": scorer, "similarity": "segment_l2", "seed": 3, "progress_steps": 400});
        serde_json::from_value(stored).unwrap()
    };
    assert_eq!(of("raw").scorer.settings["lookahead"], json!(0.0));
    let blend = of("blend");
    assert_eq!((blend.scorer.name.as_str(), &blend.scorer.settings["seed"]), ("progress", &json!(3)));
    assert!(blend.needs_all_episodes(), "its runs neither score live nor are extended");
}

#[test]
fn a_stored_seed_beyond_the_wire_is_read_and_one_from_the_wire_is_rejected() {
    let stored: PretrainSpec = serde_json::from_value(json!({"seed": u64::MAX})).unwrap();
    assert_eq!(stored.run.seed, u64::MAX);
    let message = PretrainSpec::from_values(&values(json!({"seed": 1e18}))).unwrap_err().to_string();
    assert!(message.starts_with("seed: expected a whole number between 0 and 9007199254740991, got"), "{message}");
}

#[test]
fn a_resume_may_change_only_how_the_run_is_carried_out() {
    let spec = TrainSpec::default();
    let mut carried_out = spec.clone();
    (carried_out.run.checkpoint_every, carried_out.threads) = (7, Some(2));
    let mut different = spec.clone();
    different.run.seed = 1;
    assert_eq!(spec.identity(), carried_out.identity());
    assert_ne!(spec.identity(), different.identity());
}

#[test]
fn no_two_seeds_of_an_evaluation_share_an_attempt() {
    let spec = EvaluateSpec { episodes: 3, ..EvaluateSpec::default() };
    assert_eq!(spec.attempts(0), 1 << 32..(1 << 32) + 3);
    assert_eq!(spec.attempts(1).start, 2 << 32);
    let last = u64::from(u32::MAX) - 1;
    assert!(spec.attempts(last).count() == 3 && spec.attempts(last).all(|attempt| attempt < u64::MAX));
    for wrong in [json!({"episodes": 0}), json!({"seeds": [3, 3]}), json!({"seeds": [1, 2], "episodes": 500_001})] {
        assert!(EvaluateSpec::from_values(&values(wrong)).is_err());
    }
}

#[test]
fn blocks_have_every_attempt_of_every_seed_once_and_about_equal_sizes() {
    for episodes in [1, 64, 65, 200, 1000] {
        let spec = EvaluateSpec { episodes, seeds: vec![7, 2], ..EvaluateSpec::default() };
        let blocks = spec.blocks();
        for (seed_index, seed) in [7, 2].into_iter().enumerate() {
            let of_seed: Vec<_> = blocks.iter().filter(|block| block.seed_index == seed_index).collect();
            let all: Vec<u64> = of_seed.iter().flat_map(|block| block.attempts.clone()).collect();
            assert_eq!(all, spec.attempts(seed).collect::<Vec<_>>());
            let sizes: Vec<u64> = of_seed.iter().map(|block| block.attempts.end - block.attempts.start).collect();
            assert!(sizes.iter().max().unwrap() - sizes.iter().min().unwrap() <= 1, "{sizes:?}");
            assert!(sizes.iter().all(|size| (1..=64).contains(size)), "{sizes:?}");
        }
    }
}

#[test]
fn the_learning_rate_rises_then_falls_to_nearly_zero() {
    let spec = OptimSpec { steps: 100, warmup_steps: 10, learning_rate: 1.0, ..OptimSpec::default() };
    assert!((spec.learning_rate_at(0) - 0.1).abs() < 1e-12);
    assert!(spec.learning_rate_at(9) > 0.97);
    assert!((spec.learning_rate_at(50) - 0.5).abs() < 1e-12);
    assert!(spec.learning_rate_at(99) < 1e-3);
}

#[test]
fn a_constant_schedule_stays_at_the_peak() {
    let rate_schedule = RateSchedule::Constant;
    let spec = OptimSpec { steps: 100, warmup_steps: 10, learning_rate: 1.0, rate_schedule, ..OptimSpec::default() };
    assert!((spec.learning_rate_at(0) - 0.1).abs() < 1e-12);
    assert!([9, 50, 99].iter().all(|step| (spec.learning_rate_at(*step) - 1.0).abs() < 1e-12));
}

#[test]
fn the_best_weights_need_a_validation() {
    let best = |share: f64| values(json!({"finished_weights": "best", "validation_share": share}));
    let message = TrainSpec::from_values(&best(0.0)).unwrap_err().to_string();
    assert_eq!(message, "finished_weights: best needs a validation_share above 0");
    assert!(TrainSpec::from_values(&best(0.2)).is_ok());
    let message = PretrainSpec::from_values(&best(0.0)).unwrap_err().to_string();
    assert_eq!(message, "finished_weights: best needs a validation_share above 0");
    assert_eq!(PretrainSpec::from_values(&best(0.2)).unwrap().validation_share, 0.2);
}

#[test]
fn every_default_is_allowed_by_its_own_setting() {
    for job in ["pretrain", "score", "train", "evaluate"] {
        for (setting, _) in schema_of(job) {
            assert_eq!(setting.check(&setting.default).unwrap(), setting.default, "{job}: {}", setting.name);
        }
    }
    assert!(Family::Policy.kinds().len() > 3);
}

/// The file is written by `make kinds`.
#[test]
fn the_generated_jobs_json_is_current() {
    let written = serde_json::to_string_pretty(&jobs()).unwrap() + "\n";
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/jobs.json");
    assert_eq!(std::fs::read_to_string(file).unwrap(), written, "run `make kinds`");
}
