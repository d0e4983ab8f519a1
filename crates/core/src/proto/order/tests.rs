//! Orders and pipelines survive the wire and get their defaults; wrong ones are rejected by field.

use crate::{EvaluateSpec, PretrainSpec, ScoreSpec, TrainSpec, Values, proto};
use serde_json::{Value, json};

use super::*;
use crate::{
    dataset::{ExportFormat, ExportSpec},
    id::{DatasetId, EncoderId, PolicyId, ScoreRunId, SnapshotId},
    order::TrainData,
    selection::{Selection, SelectionShape},
    snapshot::RoleRule,
};

mod refused;

/// A shape without phases, which is out of range.
const SHORT: v1::SelectionShape = v1::SelectionShape {
    min_expert_auroc: None,
    close_gaps: 0,
    min_run: 0,
    context_before: 0,
    context_after: 0,
    max_share_of_episode: None,
    phases: Some(0),
    max_per_phase: 0,
};

fn sent(spec: v1::job_spec::Spec) -> Option<v1::JobSpec> {
    Some(v1::JobSpec { spec: Some(spec) })
}

fn refusal(spec: v1::job_spec::Spec) -> String {
    order(sent(spec)).unwrap_err().message().to_owned()
}

fn values(settings: Value) -> Values {
    settings.as_object().unwrap().clone()
}

fn on_the_wire(settings: Value) -> Option<prost_types::Struct> {
    Some(proto::to_struct(&values(settings)))
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
    assert_eq!((snapshot_id, rule), (None, RoleRule::default()));
    assert_eq!(spec, PretrainSpec::default());

    let data = Some(v1::train_spec::Data::ExpertsOf(EncoderId::new().into()));
    let train = v1::job_spec::Spec::Train(v1::TrainSpec { data, ..v1::TrainSpec::default() });
    let JobOrder::Train { spec, .. } = order(sent(train)).unwrap() else { panic!("not train") };
    assert_eq!(spec, TrainSpec::default());

    let subject = Some(v1::evaluate_spec::Subject::Deployment("pick_cube@prod".into()));
    let evaluate = v1::job_spec::Spec::Evaluate(v1::EvaluateSpec { subject, ..v1::EvaluateSpec::default() });
    let JobOrder::Evaluate { subject, spec } = order(sent(evaluate)).unwrap() else { panic!("not evaluate") };
    assert_eq!(subject, Subject::Deployment("pick_cube@prod".into()));
    assert_eq!(spec, EvaluateSpec::default());
}

#[test]
fn a_complete_spec_survives_the_wire() {
    let pretrain = PretrainSpec::from_values(&values(json!({
        "preset": "base", "segment_length": 9, "steps": 7, "batch": 3, "stretch": 2, "learning_rate": 0.25,
        "weight_decay": 0.5, "warmup_steps": 2, "clip_norm": 4.0, "seed": 5, "checkpoint_every": 11, "device": "cuda",
        "objectives": ["mtp", "aa"], "shift_pixels": 4, "brightness": 0.1, "contrast": 0.2,
    })))
    .unwrap();
    let train = TrainSpec::from_values(&values(json!({
        "policy": "act", "preset": "small", "chunk_length": 5, "kl_weight": 1.5, "latent_size": 8, "shift_pixels": 1,
        "lambda": 0.3, "seed": 6, "checkpoint_every": 13, "steps": 7,
    })))
    .unwrap();
    let (encoder_id, snapshot_id, dataset_id) = (EncoderId::new(), SnapshotId::new(), DatasetId::new());

    let spec = JobSpec::Pretrain { snapshot_id: snapshot_id.clone(), spec: pretrain.clone() };
    let expected =
        JobOrder::Pretrain { snapshot_id: Some(snapshot_id.clone()), rule: RoleRule::default(), spec: pretrain };
    assert_eq!(order(Some(spec_to_proto(spec))).unwrap(), expected);

    let score = |settings: Value| ScoreSpec::from_values(&values(settings)).unwrap();
    let ssdf = score(json!({
        "scorer": "ssdf", "similarity": "segment_cosine", "feature_scale": "plain", "local_scale": false, "normaliser": "quantile",
        "scale": [0.0, 2.0, 0.5], "device": "cuda",
    }));
    let raw = score(json!({"scorer": "raw", "similarity": "segment_l2"}));
    let extends = Some(ScoreRunId::new());
    let (encoder, snapshot) = (Some(encoder_id.clone()), Some(snapshot_id.clone()));
    for score in [ssdf, raw] {
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

    let finetune = TrainSpec::from_values(&values(json!({"lambda": 0.5}))).unwrap();
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
    let evaluate = EvaluateSpec::from_values(&values(json!({
        "simulation": "pick_cube", "episodes": 7, "seeds": [3, 1], "max_steps": 90, "device": "cuda",
    })))
    .unwrap();
    let spec = JobSpec::Evaluate { policy_id: policy_id.clone(), spec: evaluate.clone() };
    let expected = JobOrder::Evaluate { subject: Subject::Policy(policy_id), spec: evaluate };
    assert_eq!(order(Some(spec_to_proto(spec))).unwrap(), expected);

    for format in ExportFormat::ALL {
        let (depth, video) = (format != ExportFormat::Mcap, format == ExportFormat::Lerobot);
        let export = ExportSpec { format, depth, video, whole: video };
        let spec = JobSpec::Export { dataset_id: dataset_id.clone(), spec: export };
        let again = JobOrder::Export { dataset_id: dataset_id.clone(), spec: export };
        assert_eq!(order(Some(spec_to_proto(spec))).unwrap(), again);
    }
}

#[test]
fn a_pipeline_with_a_missing_stage_is_rejected() {
    let full = v1::PipelineSpec {
        pretrain: Some(v1::PretrainSpec::default()),
        score: true,
        beta: Some(0.9),
        top_fraction: None,
        train: Some(v1::TrainSpec::default()),
        scoring: Some(v1::ScoreSpec {
            settings: on_the_wire(json!({"similarity": "last_cosine"})),
            ..Default::default()
        }),
        evaluate: Some(v1::EvaluateSpec { settings: on_the_wire(json!({"episodes": 5})), ..Default::default() }),
        shape: None,
    };
    let read = pipeline(Some(full.clone())).unwrap();
    assert_eq!(pipeline(Some(pipeline_to_proto(read.clone()))).unwrap(), read);

    let repeated = v1::PipelineSpec {
        pretrain: Some(v1::PretrainSpec { settings: on_the_wire(json!({"preset": "small"})), ..Default::default() }),
        train: Some(v1::TrainSpec {
            settings: on_the_wire(json!({"policy": "finetune", "preset": "small", "segment_length": 6})),
            ..Default::default()
        }),
        ..full.clone()
    };
    let finetune = TrainSpec::from_values(&values(json!({"policy": "finetune"}))).unwrap();
    assert_eq!(pipeline(Some(repeated)).unwrap().train, Some(finetune), "it may repeat the encoder's size");

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
    let shape = SelectionShape { min_expert_auroc: 0.5, ..SelectionShape::default() };
    assert_eq!(
        read.selection(),
        Some(Selection { shape, ..Selection::top_fraction(0.1) }),
        "doubtful cohorts are left out"
    );
    assert_eq!(pipeline(Some(pipeline_to_proto(read.clone()))).unwrap(), read);
    let shaped = v1::PipelineSpec {
        shape: Some(v1::SelectionShape { phases: Some(4), max_per_phase: 3, ..SHORT }),
        ..full.clone()
    };
    let read = pipeline(Some(shaped)).unwrap();
    assert_eq!(read.selection().map(|one| (one.shape.phases, one.shape.min_expert_auroc)), Some((4, 0.5)));
    assert_eq!(pipeline(Some(pipeline_to_proto(read.clone()))).unwrap(), read);
    let every = v1::SelectionShape { min_expert_auroc: Some(0.0), phases: None, ..SHORT };
    let every = v1::PipelineSpec { shape: Some(every), ..full.clone() };
    let read = pipeline(Some(every)).unwrap();
    assert!(read.shape.is_off(), "0 keeps every cohort");
    assert_eq!(pipeline(Some(pipeline_to_proto(read.clone()))).unwrap(), read);
    assert!(broken(|spec| spec.shape = Some(SHORT)).starts_with("pipeline.shape.phases: "));
    assert!(
        broken(|spec| (spec.beta, spec.train, spec.evaluate, spec.shape) = (None, None, None, Some(SHORT)))
            .starts_with("pipeline.shape: needs a dataset")
    );
    assert!(
        broken(|spec| {
            let data = Some(v1::train_spec::Data::DatasetId(String::new()));
            spec.train = Some(v1::TrainSpec { data, ..v1::TrainSpec::default() });
        })
        .starts_with("pipeline.train.data: ")
    );
}
