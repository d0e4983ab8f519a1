//! Every wrong field of an order is named by its path, with its allowed values.

use super::*;

type Sent = v1::job_spec::Spec;

fn pretrain_of(settings: Value) -> Sent {
    pretrain_with(|spec| spec.settings = on_the_wire(settings))
}

fn score_with(change: impl FnOnce(&mut v1::ScoreSpec)) -> Sent {
    let mut spec = v1::ScoreSpec { encoder_id: EncoderId::new().into(), ..v1::ScoreSpec::default() };
    change(&mut spec);
    Sent::Score(spec)
}

fn score_of(settings: Value) -> Sent {
    score_with(|spec| spec.settings = on_the_wire(settings))
}

fn train_with(settings: Value, change: impl FnOnce(&mut v1::TrainSpec)) -> Sent {
    let data = Some(v1::train_spec::Data::ExpertsIn(SnapshotId::new().into()));
    let mut spec = v1::TrainSpec { data, settings: on_the_wire(settings) };
    change(&mut spec);
    Sent::Train(spec)
}

/// A training order of ACT, which starts from scratch.
fn act_of(settings: Value) -> Sent {
    let mut all = values(json!({"policy": "act"}));
    all.extend(values(settings));
    train_with(Value::Object(all), |_| {})
}

fn evaluate_with(change: impl FnOnce(&mut v1::EvaluateSpec)) -> Sent {
    let subject = Some(v1::evaluate_spec::Subject::PolicyId(PolicyId::new().into()));
    let mut spec = v1::EvaluateSpec { subject, ..v1::EvaluateSpec::default() };
    change(&mut spec);
    Sent::Evaluate(spec)
}

fn evaluate_of(settings: Value) -> Sent {
    evaluate_with(|spec| spec.settings = on_the_wire(settings))
}

fn each_is_rejected<const N: usize>(cases: [(Sent, &str); N]) {
    for (spec, field) in cases {
        let message = refusal(spec);
        assert!(message.starts_with(field), "{field} expected in {message:?}");
    }
}

#[test]
fn a_wrong_field_is_named_by_its_path() {
    assert_eq!(order(None).unwrap_err().message(), "spec: must be set");
    let negative = || Some(v1::RoleRule { imperfect_per_expert: -1.0, ..Default::default() });
    each_is_rejected([
        (pretrain_with(|spec| spec.snapshot_id = "../x".into()), "spec.pretrain.snapshot_id: "),
        (pretrain_with(|spec| spec.rule = negative()), "spec.pretrain.rule.imperfect_per_expert: "),
        (score_with(|spec| spec.encoder_id = "enc_7".into()), "spec.score.encoder_id: "),
        (score_with(|spec| spec.extends = "enc_7".into()), "spec.score.extends: "),
        (train_with(json!({"policy": "act"}), |spec| spec.data = None), "spec.train.data: must be set"),
        (
            train_with(json!({"policy": "finetune"}), |_| {}),
            "spec.train.experts_in: names no encoder, which finetune starts from",
        ),
        (evaluate_with(|spec| spec.subject = None), "spec.evaluate.subject: must be set"),
        (
            evaluate_with(|spec| spec.subject = Some(v1::evaluate_spec::Subject::Deployment("a b".into()))),
            "spec.evaluate.deployment: ",
        ),
        (
            Sent::Export(v1::ExportSpec {
                dataset_id: DatasetId::new().into(),
                format: 9,
                ..v1::ExportSpec::default()
            }),
            "spec.export.format: unknown value",
        ),
    ]);
}

#[test]
fn a_setting_that_has_no_effect_is_rejected() {
    each_is_rejected([
        (
            score_of(json!({"scorer": "raw", "feature_scale": "plain"})),
            "spec.score.settings.feature_scale: has no effect",
        ),
        (score_of(json!({"scorer": "classifier", "scale": [2, 0, 0]})), "spec.score.settings.scale: has no effect"),
        (
            train_with(json!({"policy": "bc", "chunk_length": 3}), |_| {}),
            "spec.train.settings.chunk_length: has no effect",
        ),
        (act_of(json!({"segment_length": 3})), "spec.train.settings.segment_length: has no effect"),
        (
            train_with(json!({"policy": "finetune", "preset": "base"}), |_| {}),
            "spec.train.settings.preset: has no effect",
        ),
    ]);
}

#[test]
fn an_unknown_setting_or_word_is_rejected() {
    each_is_rejected([
        (pretrain_of(json!({"stepps": 1})), "spec.pretrain.settings.stepps: unknown setting; supported: preset, "),
        (
            pretrain_of(json!({"preset": "huge"})),
            "spec.pretrain.settings.preset: unknown value \"huge\"; supported: tiny, ",
        ),
        (pretrain_of(json!({"device": 77})), "spec.pretrain.settings.device: expected cpu, cuda, got 77"),
        (pretrain_of(json!({"objectives": ["mtp", "x"]})), "spec.pretrain.settings.objectives: [1] unknown value"),
        (pretrain_of(json!({"objectives": ["mtp", "mtp"]})), "spec.pretrain.settings.objectives: [1] is \"mtp\" again"),
        (score_of(json!({"scorer": "x"})), "spec.score.settings.scorer: unknown value"),
        (score_of(json!({"similarity": "x"})), "spec.score.settings.similarity: unknown value"),
        (score_of(json!({"normaliser": "x"})), "spec.score.settings.normaliser: unknown value"),
        (score_of(json!({"scorer": "ssdf", "feature_scale": "x"})), "spec.score.settings.feature_scale: unknown value"),
        (score_of(json!({"local_scale": "local"})), "spec.score.settings.local_scale: expected true or false"),
        (score_of(json!({"device": "tpu"})), "spec.score.settings.device: unknown value"),
        (act_of(json!({"preset": 1})), "spec.train.settings.preset: expected tiny, "),
        (act_of(json!({"policy": {}})), "spec.train.settings.policy: expected bc, "),
        (evaluate_of(json!({"device": "x"})), "spec.evaluate.settings.device: unknown value"),
    ]);
}

#[test]
fn every_number_of_a_spec_is_checked() {
    for (settings, field) in [
        (json!({"steps": 0}), "steps: is 0"),
        (json!({"steps": 1.5}), "steps: expected a whole number"),
        (json!({"batch": 0}), "batch: is 0"),
        (json!({"batch": 4294967295u32}), "batch: is 4294967295, must be between 1 and 65536"),
        (json!({"stretch": 0}), "stretch: is 0"),
        (json!({"learning_rate": 0.0}), "learning_rate: is 0"),
        (json!({"learning_rate": "1"}), "learning_rate: expected a number"),
        (json!({"weight_decay": -0.1}), "weight_decay: is -0.1"),
        (json!({"clip_norm": 0.0}), "clip_norm: is 0"),
        (json!({"checkpoint_every": 0}), "checkpoint_every: is 0"),
        (json!({"seed": -1}), "seed: expected a whole number"),
        (json!({"shift_pixels": 1025}), "shift_pixels: is 1025"),
        (json!({"brightness": 1.1}), "brightness: is 1.1"),
        (json!({"contrast": -0.1}), "contrast: is -0.1"),
    ] {
        let message = refusal(pretrain_of(settings.clone()));
        assert!(message.starts_with(&format!("spec.pretrain.settings.{field}")), "{field} expected in {message:?}");
        let message = refusal(act_of(settings));
        assert!(message.starts_with(&format!("spec.train.settings.{field}")), "{field} expected in {message:?}");
    }
    each_is_rejected([
        (pretrain_of(json!({"segment_length": 64})), "spec.pretrain.settings.segment_length: is 64"),
        (act_of(json!({"chunk_length": 257})), "spec.train.settings.chunk_length: is 257"),
        (act_of(json!({"kl_weight": -1})), "spec.train.settings.kl_weight: is -1"),
        (act_of(json!({"latent_size": 0})), "spec.train.settings.latent_size: is 0"),
        (act_of(json!({"lambda": -1.0})), "spec.train.settings.lambda: is -1"),
        (train_with(json!({"history_dropout": 1.5}), |_| {}), "spec.train.settings.history_dropout: is 1.5"),
        (score_of(json!({"scale": [-1, 1, 1]})), "spec.score.settings.scale: image is -1"),
        (score_of(json!({"scale": [0, 0, 0]})), "spec.score.settings.scale: is 0 for image, "),
        (score_of(json!({"scale": [1, 1]})), "spec.score.settings.scale: expected 3 numbers"),
        (evaluate_of(json!({"episodes": 1_000_001})), "spec.evaluate.settings.episodes: is 1000001"),
        (evaluate_of(json!({"episodes": 500_001, "seeds": [1, 2]})), "spec.evaluate.settings.episodes: make 1000002"),
        (evaluate_of(json!({"max_steps": 10_001})), "spec.evaluate.settings.max_steps: is 10001"),
        (evaluate_of(json!({"seeds": (0..1001).collect::<Vec<u32>>()})), "spec.evaluate.settings.seeds: has 1001"),
        (evaluate_of(json!({"seeds": [4_294_967_295_u32]})), "spec.evaluate.settings.seeds: [0] is 4294967295"),
        (evaluate_of(json!({"simulation": "a\nb"})), "spec.evaluate.settings.simulation: "),
    ]);
}

/// Numbers on the wire are doubles; JSON has no form for some of them.
#[test]
fn malformed_numbers_are_rejected() {
    for wrong in [f64::NAN, f64::INFINITY] {
        let value = prost_types::Value { kind: Some(prost_types::value::Kind::NumberValue(wrong)) };
        let fields = [("learning_rate".to_owned(), value)].into();
        let message = refusal(pretrain_with(|spec| spec.settings = Some(prost_types::Struct { fields })));
        assert!(message.starts_with("spec.pretrain.settings.learning_rate: expected a number"), "{message}");
    }
}
