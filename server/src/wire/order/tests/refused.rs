//! Every wrong field of an order is named by its path, with what it must be.

use super::*;

#[test]
fn a_wrong_field_is_named_by_its_path() {
    assert_eq!(order(None).unwrap_err().message(), "spec: must be set");
    let experts_in = || Some(v1::train_spec::Data::ExpertsIn(SnapshotId::new().into()));
    let train = |change: fn(&mut v1::TrainSpec)| {
        let mut spec = v1::TrainSpec { data: experts_in(), policy: v1::PolicyKind::Act.into(), ..Default::default() };
        change(&mut spec);
        v1::job_spec::Spec::Train(spec)
    };
    let score = |change: fn(&mut v1::ScoreSpec)| {
        let mut spec = v1::ScoreSpec { encoder_id: EncoderId::new().into(), ..v1::ScoreSpec::default() };
        change(&mut spec);
        v1::job_spec::Spec::Score(spec)
    };
    let evaluate = |change: fn(&mut v1::EvaluateSpec)| {
        let subject = Some(v1::evaluate_spec::Subject::PolicyId(PolicyId::new().into()));
        let mut spec = v1::EvaluateSpec { subject, ..v1::EvaluateSpec::default() };
        change(&mut spec);
        v1::job_spec::Spec::Evaluate(spec)
    };
    let steps = |steps| Some(v1::OptimSpec { steps: Some(steps), ..v1::OptimSpec::default() });
    let cases = [
        (pretrain_with(|spec| spec.optim = steps(0)), "spec.pretrain.optim.steps: "),
        (pretrain_with(|spec| spec.segment_length = Some(64)), "spec.pretrain.segment_length: "),
        (pretrain_with(|spec| spec.checkpoint_every = Some(0)), "spec.pretrain.checkpoint_every: "),
        (pretrain_with(|spec| spec.preset = 77), "spec.pretrain.preset: "),
        (pretrain_with(|spec| spec.device = 77), "spec.pretrain.device: "),
        (pretrain_with(|spec| spec.snapshot_id = "../x".into()), "spec.pretrain.snapshot_id: "),
        (pretrain_with(|spec| spec.objectives = vec![1, 0]), "spec.pretrain.objectives[1]: "),
        (pretrain_with(|spec| spec.objectives = vec![1, 9]), "spec.pretrain.objectives[1]: "),
        (pretrain_with(|spec| spec.objectives = vec![3, 1, 3]), "spec.pretrain.objectives[2]: "),
        (
            pretrain_with(|spec| {
                spec.augmentation = Some(v1::Augmentation { contrast: f64::NAN, ..Default::default() });
            }),
            "spec.pretrain.augmentation.contrast: ",
        ),
        (
            pretrain_with(|spec| {
                spec.rule = Some(v1::RoleRule { imperfect_per_expert: -1.0, ..Default::default() });
            }),
            "spec.pretrain.rule.imperfect_per_expert: ",
        ),
        (v1::job_spec::Spec::Score(v1::ScoreSpec::default()), "spec.score.encoder_id: "),
        (score(|spec| spec.scorer = 9), "spec.score.scorer: "),
        (score(|spec| spec.similarity = 9), "spec.score.similarity: "),
        (score(|spec| spec.normaliser = 9), "spec.score.normaliser: "),
        (score(|spec| spec.feature_scale = 9), "spec.score.feature_scale: "),
        (score(|spec| spec.yardstick = 9), "spec.score.yardstick: "),
        (score(|spec| spec.extends = "enc_7".into()), "spec.score.extends: "),
        (
            score(|spec| (spec.scorer, spec.feature_scale) = (v1::Scorer::Raw.into(), v1::FeatureScale::Plain.into())),
            "spec.score.feature_scale: has no effect",
        ),
        (
            score(|spec| {
                spec.scorer = v1::Scorer::Classifier.into();
                spec.modality_scale = Some(v1::ModalityScale { image: 2.0, ..Default::default() });
            }),
            "spec.score.modality_scale: has no effect",
        ),
        (
            score(|spec| spec.modality_scale = Some(v1::ModalityScale { action: -1.0, ..Default::default() })),
            "spec.score.modality_scale.action: ",
        ),
        (score(|spec| spec.modality_scale = Some(v1::ModalityScale::default())), "spec.score.modality_scale: "),
        (train(|spec| spec.policy = 9), "spec.train.policy: "),
        (train(|spec| spec.policy = 0), "spec.train.experts_in: "),
        (train(|spec| spec.preset = 9), "spec.train.preset: "),
        (train(|spec| spec.segment_length = Some(64)), "spec.train.segment_length: "),
        (train(|spec| spec.segment_length = Some(3)), "spec.train.segment_length: is for policies with a history"),
        (
            train(|spec| spec.act = Some(v1::ActSpec { chunk_length: Some(0), ..Default::default() })),
            "spec.train.act.chunk_length: ",
        ),
        (
            train(|spec| (spec.policy, spec.act) = (v1::PolicyKind::Bc.into(), Some(v1::ActSpec::default()))),
            "spec.train.act: ",
        ),
        (train(|spec| (spec.policy, spec.preset) = (0, v1::Preset::Small.into())), "spec.train.preset: "),
        (train(|spec| (spec.policy, spec.segment_length) = (0, Some(3))), "spec.train.segment_length: "),
        (train(|spec| spec.history_dropout = Some(1.5)), "spec.train.history_dropout: "),
        (evaluate(|spec| spec.subject = None), "spec.evaluate.subject: "),
        (evaluate(|spec| spec.episodes = Some(0)), "spec.evaluate.episodes: "),
        (evaluate(|spec| spec.max_steps = Some(0)), "spec.evaluate.max_steps: "),
        (evaluate(|spec| spec.seeds = vec![4, 4]), "spec.evaluate.seeds: "),
        (evaluate(|spec| spec.device = 9), "spec.evaluate.device: "),
        (v1::job_spec::Spec::Train(v1::TrainSpec::default()), "spec.train.data: "),
        (
            v1::job_spec::Spec::Train(v1::TrainSpec { lambda: Some(f64::NAN), ..v1::TrainSpec::default() }),
            "spec.train.lambda: ",
        ),
        (
            v1::job_spec::Spec::Export(v1::ExportSpec { dataset_id: DatasetId::new().into(), format: 9 }),
            "spec.export.format: ",
        ),
    ];
    for (spec, field) in cases {
        let message = refusal(spec);
        assert!(message.starts_with(field), "{field} expected in {message:?}");
    }
}

type Sent = v1::job_spec::Spec;

fn score_with(change: impl FnOnce(&mut v1::ScoreSpec)) -> Sent {
    let mut spec = v1::ScoreSpec { encoder_id: EncoderId::new().into(), ..v1::ScoreSpec::default() };
    change(&mut spec);
    Sent::Score(spec)
}

fn train_with(change: impl FnOnce(&mut v1::TrainSpec)) -> Sent {
    let data = Some(v1::train_spec::Data::ExpertsIn(SnapshotId::new().into()));
    let mut spec = v1::TrainSpec { data, policy: v1::PolicyKind::Act.into(), ..v1::TrainSpec::default() };
    change(&mut spec);
    Sent::Train(spec)
}

fn evaluate_with(change: impl FnOnce(&mut v1::EvaluateSpec)) -> Sent {
    let subject = Some(v1::evaluate_spec::Subject::PolicyId(PolicyId::new().into()));
    let mut spec = v1::EvaluateSpec { subject, ..v1::EvaluateSpec::default() };
    change(&mut spec);
    Sent::Evaluate(spec)
}

#[test]
fn every_enum_of_a_spec_is_checked() {
    for wrong in [-1, 77] {
        for (spec, field) in [
            (pretrain_with(|spec| spec.preset = wrong), "spec.pretrain.preset: "),
            (pretrain_with(|spec| spec.device = wrong), "spec.pretrain.device: "),
            (score_with(|spec| spec.device = wrong), "spec.score.device: "),
            (train_with(|spec| spec.preset = wrong), "spec.train.preset: "),
            (train_with(|spec| spec.device = wrong), "spec.train.device: "),
            (train_with(|spec| spec.policy = wrong), "spec.train.policy: "),
            (evaluate_with(|spec| spec.device = wrong), "spec.evaluate.device: "),
        ] {
            let message = refusal(spec);
            assert!(message.starts_with(field), "{field} expected in {message:?}");
        }
    }
}

#[test]
fn every_number_of_a_spec_is_checked() {
    type Optim = fn(&mut v1::OptimSpec);
    let optims: [(Optim, &str); 8] = [
        (|optim| optim.steps = Some(0), "optim.steps: "),
        (|optim| optim.batch = Some(0), "optim.batch: "),
        (|optim| optim.batch = Some(u32::MAX), "optim.batch: "),
        (|optim| optim.learning_rate = Some(0.0), "optim.learning_rate: "),
        (|optim| optim.learning_rate = Some(f64::INFINITY), "optim.learning_rate: "),
        (|optim| optim.weight_decay = Some(-0.1), "optim.weight_decay: "),
        (|optim| optim.clip_norm = Some(0.0), "optim.clip_norm: "),
        (|optim| optim.clip_norm = Some(f64::NAN), "optim.clip_norm: "),
    ];
    for (change, field) in optims {
        let mut optim = v1::OptimSpec::default();
        change(&mut optim);
        let message = refusal(pretrain_with(|spec| spec.optim = Some(optim)));
        assert!(message.starts_with(&format!("spec.pretrain.{field}")), "{field} expected in {message:?}");
        let message = refusal(train_with(|spec| spec.optim = Some(optim)));
        assert!(message.starts_with(&format!("spec.train.{field}")), "{field} expected in {message:?}");
    }
    let shaken = |shift_pixels, brightness, contrast| Some(v1::Augmentation { shift_pixels, brightness, contrast });
    let act = |chunk, kl, latent| Some(v1::ActSpec { chunk_length: chunk, kl_weight: kl, latent_size: latent });
    let scale = |image, proprioception, action| Some(v1::ModalityScale { image, proprioception, action });
    for (spec, field) in [
        (pretrain_with(|spec| spec.augmentation = shaken(1025, 0.0, 0.0)), "spec.pretrain.augmentation.shift_pixels: "),
        (pretrain_with(|spec| spec.augmentation = shaken(0, 1.1, 0.0)), "spec.pretrain.augmentation.brightness: "),
        (train_with(|spec| spec.augmentation = shaken(0, 0.0, -0.1)), "spec.train.augmentation.contrast: "),
        (train_with(|spec| spec.checkpoint_every = Some(0)), "spec.train.checkpoint_every: "),
        (train_with(|spec| spec.act = act(Some(257), None, None)), "spec.train.act.chunk_length: "),
        (train_with(|spec| spec.act = act(None, Some(f64::NAN), None)), "spec.train.act.kl_weight: "),
        (train_with(|spec| spec.act = act(None, None, Some(0))), "spec.train.act.latent_size: "),
        (train_with(|spec| spec.lambda = Some(-1.0)), "spec.train.lambda: "),
        (train_with(|spec| spec.lambda = Some(f64::INFINITY)), "spec.train.lambda: "),
        (score_with(|spec| spec.modality_scale = scale(-1.0, 1.0, 1.0)), "spec.score.modality_scale.image: "),
        (
            score_with(|spec| spec.modality_scale = scale(1.0, f64::NAN, 1.0)),
            "spec.score.modality_scale.proprioception: ",
        ),
        (score_with(|spec| spec.modality_scale = scale(1.0, 1.0, 1e7)), "spec.score.modality_scale.action: "),
        (evaluate_with(|spec| spec.episodes = Some(1_000_001)), "spec.evaluate.episodes: "),
        (evaluate_with(|spec| spec.max_steps = Some(10_001)), "spec.evaluate.max_steps: "),
        (evaluate_with(|spec| spec.seeds = (0..1001).collect()), "spec.evaluate.seeds: "),
        (evaluate_with(|spec| spec.seeds = vec![u64::MAX]), "spec.evaluate.seeds: "),
    ] {
        let message = refusal(spec);
        assert!(message.starts_with(field), "{field} expected in {message:?}");
    }
}
