//! Orders and pipelines survive the wire, get their defaults, and are refused by field.

use gleaner_learn::{
    ActSpec, Augmentation, Device, FeatureScale, ModelSpec, NormaliserKind, Objective, OptimSpec, PolicyKind, Preset,
    PretrainSpec, ScoreSpec, Scorer, Similarity, TrainSpec, Yardstick,
};

use super::*;
use crate::domain::{
    evaluation::EvaluateSpec,
    id::{EncoderId, PolicyId, ScoreRunId, SnapshotId},
    order::TrainData,
    selection::Selection,
    snapshot::RoleRule,
};

mod refused;

fn sent(spec: v1::job_spec::Spec) -> Option<v1::JobSpec> {
    Some(v1::JobSpec { spec: Some(spec) })
}

fn refusal(spec: v1::job_spec::Spec) -> String {
    order(sent(spec)).unwrap_err().message().to_owned()
}

fn pretrain_with(change: impl FnOnce(&mut v1::PretrainSpec)) -> v1::job_spec::Spec {
    let mut spec = v1::PretrainSpec::default();
    change(&mut spec);
    v1::job_spec::Spec::Pretrain(spec)
}

#[test]
fn an_empty_spec_means_the_defaults() {
    let JobOrder::Pretrain { snapshot_id, rule, spec } = order(sent(pretrain_with(|_| {}))).unwrap() else {
        panic!("not pretrain");
    };
    let model = ModelSpec { preset: Preset::Tiny, ..ModelSpec::default() };
    assert_eq!((snapshot_id, rule), (None, RoleRule::default()));
    assert_eq!(spec, PretrainSpec { model, ..PretrainSpec::default() });
    assert_eq!(spec.objectives, [Objective::Mtp, Objective::Tr, Objective::Aa]);

    let data = Some(v1::train_spec::Data::ExpertsOf(EncoderId::new().into()));
    let train = v1::job_spec::Spec::Train(v1::TrainSpec { data, ..v1::TrainSpec::default() });
    let JobOrder::Train { spec, .. } = order(sent(train)).unwrap() else { panic!("not train") };
    assert_eq!(spec, TrainSpec { model, ..TrainSpec::default() });

    let subject = Some(v1::evaluate_spec::Subject::Deployment("pick_cube@prod".into()));
    let evaluate = v1::job_spec::Spec::Evaluate(v1::EvaluateSpec { subject, ..v1::EvaluateSpec::default() });
    let JobOrder::Evaluate { subject, spec } = order(sent(evaluate)).unwrap() else { panic!("not evaluate") };
    assert_eq!(subject, Subject::Deployment("pick_cube@prod".into()));
    assert_eq!(
        spec,
        EvaluateSpec { simulation: String::new(), episodes: 200, seeds: vec![0], max_steps: 60, device: Device::Cpu }
    );
}

#[test]
fn a_complete_spec_survives_the_wire() {
    let optim = OptimSpec {
        steps: 7,
        batch: 3,
        learning_rate: 0.25,
        weight_decay: 0.5,
        warmup_steps: 2,
        clip_norm: 4.0,
        ..OptimSpec::default()
    };
    let pretrain = PretrainSpec {
        model: ModelSpec { preset: Preset::Base, segment_length: 9 },
        optim: optim.clone(),
        seed: 5,
        checkpoint_every: 11,
        device: Device::Cuda,
        objectives: vec![Objective::Mtp, Objective::Aa],
        augmentation: Augmentation { shift_pixels: 4, brightness: 0.1, contrast: 0.2 },
        ..PretrainSpec::default()
    };
    let train = TrainSpec {
        policy: PolicyKind::Act,
        model: ModelSpec { preset: Preset::Small, ..ModelSpec::default() },
        act: ActSpec { chunk_length: 5, kl_weight: 1.5, latent_size: 8 },
        augmentation: Augmentation { shift_pixels: 1, ..Augmentation::default() },
        optim,
        lambda: 0.3,
        seed: 6,
        checkpoint_every: 13,
        ..TrainSpec::default()
    };
    let (encoder_id, snapshot_id, dataset_id) = (EncoderId::new(), SnapshotId::new(), DatasetId::new());

    let spec = JobSpec::Pretrain { snapshot_id: snapshot_id.clone(), spec: pretrain.clone() };
    let expected =
        JobOrder::Pretrain { snapshot_id: Some(snapshot_id.clone()), rule: RoleRule::default(), spec: pretrain };
    assert_eq!(order(Some(spec_to_proto(spec))).unwrap(), expected);

    let score = ScoreSpec {
        scorer: Scorer::Ssdf,
        similarity: Similarity::SegmentCosine,
        feature_scale: FeatureScale::Plain,
        yardstick: Yardstick::None,
        normaliser: NormaliserKind::Quantile,
        modality_scale: Some([0.0, 2.0, 0.5]),
        seed: 4,
        device: Device::Cuda,
        ..ScoreSpec::default()
    };
    let raw = ScoreSpec { scorer: Scorer::Raw, feature_scale: FeatureScale::default(), ..score.clone() };
    let extends = Some(ScoreRunId::new());
    let (encoder, snapshot) = (Some(encoder_id.clone()), Some(snapshot_id.clone()));
    for score in [score, raw] {
        let spec = JobSpec::Score {
            encoder_id: encoder_id.clone(),
            snapshot_id: snapshot_id.clone(),
            extends: extends.clone(),
            spec: score.clone(),
        };
        let expected = JobOrder::Score {
            encoder_id: encoder.clone(),
            snapshot_id: snapshot.clone(),
            extends: extends.clone(),
            spec: score,
        };
        assert_eq!(order(Some(spec_to_proto(spec))).unwrap(), expected);
    }

    let finetune = TrainSpec {
        policy: PolicyKind::Finetune,
        act: ActSpec::default(),
        model: ModelSpec { preset: Preset::Tiny, ..ModelSpec::default() },
        ..train.clone()
    };
    for (encoder_id, dataset_id, data, train) in [
        (None, Some(dataset_id.clone()), TrainData::Dataset(dataset_id.clone()), &train),
        (Some(encoder_id.clone()), None, TrainData::ExpertsOf(encoder_id.clone()), &finetune),
        (None, None, TrainData::ExpertsIn(snapshot_id.clone()), &train),
    ] {
        let snapshot_id = snapshot_id.clone();
        let spec = JobSpec::Train { encoder_id, snapshot_id, dataset_id, spec: train.clone() };
        let expected = JobOrder::Train { data, spec: train.clone() };
        assert_eq!(order(Some(spec_to_proto(spec))).unwrap(), expected);
    }

    let policy_id = PolicyId::new();
    let evaluate = EvaluateSpec {
        simulation: "pick_cube".into(),
        episodes: 7,
        seeds: vec![3, 1],
        max_steps: 90,
        device: Device::Cuda,
    };
    let spec = JobSpec::Evaluate { policy_id: policy_id.clone(), spec: evaluate.clone() };
    let expected = JobOrder::Evaluate { subject: Subject::Policy(policy_id), spec: evaluate };
    assert_eq!(order(Some(spec_to_proto(spec))).unwrap(), expected);

    let spec = JobSpec::Export { dataset_id: dataset_id.clone() };
    assert_eq!(order(Some(spec_to_proto(spec))).unwrap(), JobOrder::Export { dataset_id });
}

#[test]
fn a_pipeline_has_no_gaps() {
    let full = v1::PipelineSpec {
        pretrain: Some(v1::PretrainSpec::default()),
        score: true,
        beta: Some(0.9),
        top_fraction: None,
        train: Some(v1::TrainSpec::default()),
        scoring: Some(v1::ScoreSpec { similarity: v1::Similarity::LastCosine.into(), ..Default::default() }),
        evaluate: Some(v1::EvaluateSpec { episodes: Some(5), ..v1::EvaluateSpec::default() }),
    };
    let read = pipeline(Some(full.clone())).unwrap();
    assert_eq!(pipeline(Some(pipeline_to_proto(read.clone()))).unwrap(), read);

    let repeated = v1::PipelineSpec {
        pretrain: Some(v1::PretrainSpec { preset: v1::Preset::Small.into(), ..Default::default() }),
        train: Some(v1::TrainSpec { preset: v1::Preset::Small.into(), segment_length: Some(6), ..Default::default() }),
        ..full.clone()
    };
    assert_eq!(pipeline(Some(repeated)).unwrap().train, read.train, "finetune may repeat the encoder's size");

    let broken = |change: fn(&mut v1::PipelineSpec)| {
        let mut spec = full.clone();
        change(&mut spec);
        pipeline(Some(spec)).unwrap_err().message().to_owned()
    };
    assert!(broken(|spec| spec.pretrain = None).starts_with("pipeline.pretrain: "));
    assert!(broken(|spec| spec.score = false).starts_with("pipeline.scoring: "));
    assert!(broken(|spec| (spec.score, spec.scoring) = (false, None)).starts_with("pipeline.beta: "));
    assert!(broken(|spec| spec.train = None).starts_with("pipeline.evaluate: "));
    assert!(
        broken(|spec| spec.scoring = Some(v1::ScoreSpec { extends: "run_7".into(), ..Default::default() }))
            .starts_with("pipeline.scoring.extends: ")
    );
    assert!(
        broken(|spec| {
            let subject = Some(v1::evaluate_spec::Subject::Deployment("x".into()));
            spec.evaluate = Some(v1::EvaluateSpec { subject, ..v1::EvaluateSpec::default() });
        })
        .starts_with("pipeline.evaluate.subject: ")
    );
    assert!(broken(|spec| spec.beta = None).starts_with("pipeline.train: "));
    assert!(broken(|spec| spec.beta = Some(1.5)).starts_with("pipeline.beta: "));
    assert!(broken(|spec| spec.top_fraction = Some(0.1)).starts_with("pipeline.top_fraction: a dataset has one rule"));
    assert!(broken(|spec| (spec.beta, spec.top_fraction) = (None, Some(0.0))).starts_with("pipeline.top_fraction: "));
    let best = v1::PipelineSpec { beta: None, top_fraction: Some(0.1), ..full.clone() };
    let read = pipeline(Some(best)).unwrap();
    assert_eq!(read.selection(), Some(Selection::TopFraction(0.1)));
    assert_eq!(pipeline(Some(pipeline_to_proto(read.clone()))).unwrap(), read);
    assert!(
        broken(|spec| {
            let data = Some(v1::train_spec::Data::DatasetId(String::new()));
            spec.train = Some(v1::TrainSpec { data, ..v1::TrainSpec::default() });
        })
        .starts_with("pipeline.train.data: ")
    );
}
