//! Orders and pipelines survive the wire, get their defaults, and are refused by field.

#![allow(clippy::unwrap_used, clippy::panic)]

use super::*;

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

    let data = Some(v1::train_spec::Data::ExpertsOf(EncoderId::new().into()));
    let train = v1::job_spec::Spec::Train(v1::TrainSpec { data, ..v1::TrainSpec::default() });
    let JobOrder::Train { spec, .. } = order(sent(train)).unwrap() else { panic!("not train") };
    assert_eq!(spec, TrainSpec::default());
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
        ..PretrainSpec::default()
    };
    let train = TrainSpec { optim, lambda: 0.3, seed: 6, checkpoint_every: 13, ..TrainSpec::default() };
    let (encoder_id, snapshot_id, dataset_id) = (EncoderId::new(), SnapshotId::new(), DatasetId::new());

    let spec = JobSpec::Pretrain { snapshot_id: snapshot_id.clone(), spec: pretrain.clone() };
    let expected =
        JobOrder::Pretrain { snapshot_id: Some(snapshot_id.clone()), rule: RoleRule::default(), spec: pretrain };
    assert_eq!(order(Some(spec_to_proto(spec))).unwrap(), expected);

    let score = ScoreSpec { device: Device::Cuda, ..ScoreSpec::default() };
    let spec = JobSpec::Score { encoder_id: encoder_id.clone(), snapshot_id: snapshot_id.clone(), spec: score.clone() };
    let expected =
        JobOrder::Score { encoder_id: encoder_id.clone(), snapshot_id: Some(snapshot_id.clone()), spec: score };
    assert_eq!(order(Some(spec_to_proto(spec))).unwrap(), expected);

    for (dataset_id, data) in [
        (Some(dataset_id.clone()), TrainData::Dataset(dataset_id.clone())),
        (None, TrainData::ExpertsOf(encoder_id.clone())),
    ] {
        let (encoder_id, snapshot_id) = (encoder_id.clone(), snapshot_id.clone());
        let spec = JobSpec::Train { encoder_id, snapshot_id, dataset_id, spec: train.clone() };
        let expected = JobOrder::Train { data, spec: train.clone() };
        assert_eq!(order(Some(spec_to_proto(spec))).unwrap(), expected);
    }

    let spec = JobSpec::Export { dataset_id: dataset_id.clone() };
    assert_eq!(order(Some(spec_to_proto(spec))).unwrap(), JobOrder::Export { dataset_id });
}

#[test]
fn a_wrong_field_is_named_by_its_path() {
    assert_eq!(order(None).unwrap_err().message(), "spec: must be set");
    let steps = |steps| Some(v1::OptimSpec { steps: Some(steps), ..v1::OptimSpec::default() });
    let cases = [
        (pretrain_with(|spec| spec.optim = steps(0)), "spec.pretrain.optim.steps: "),
        (pretrain_with(|spec| spec.segment_length = Some(64)), "spec.pretrain.segment_length: "),
        (pretrain_with(|spec| spec.checkpoint_every = Some(0)), "spec.pretrain.checkpoint_every: "),
        (pretrain_with(|spec| spec.preset = 77), "spec.pretrain.preset: "),
        (pretrain_with(|spec| spec.device = 77), "spec.pretrain.device: "),
        (pretrain_with(|spec| spec.snapshot_id = "../x".into()), "spec.pretrain.snapshot_id: "),
        (v1::job_spec::Spec::Score(v1::ScoreSpec::default()), "spec.score.encoder_id: "),
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

#[test]
fn a_pipeline_has_no_gaps() {
    let full = v1::PipelineSpec {
        pretrain: Some(v1::PretrainSpec::default()),
        score: true,
        beta: Some(0.9),
        train: Some(v1::TrainSpec::default()),
    };
    let read = pipeline(Some(full.clone())).unwrap();
    assert_eq!(pipeline(Some(pipeline_to_proto(read.clone()))).unwrap(), read);

    let broken = |change: fn(&mut v1::PipelineSpec)| {
        let mut spec = full.clone();
        change(&mut spec);
        pipeline(Some(spec)).unwrap_err().message().to_owned()
    };
    assert!(broken(|spec| spec.pretrain = None).starts_with("pipeline.pretrain: "));
    assert!(broken(|spec| spec.score = false).starts_with("pipeline.beta: "));
    assert!(broken(|spec| spec.beta = None).starts_with("pipeline.train: "));
    assert!(broken(|spec| spec.beta = Some(1.5)).starts_with("pipeline.beta: "));
    assert!(
        broken(|spec| {
            let data = Some(v1::train_spec::Data::DatasetId(String::new()));
            spec.train = Some(v1::TrainSpec { data, ..v1::TrainSpec::default() });
        })
        .starts_with("pipeline.train.data: ")
    );
}
