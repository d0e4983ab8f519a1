//! Settings that are wrong: each is refused by its path, with the mend, before anything is queued.

use gleaner_proto::v1::*;
use tonic::Code;

use crate::{
    bad_input::{quiet_lab, refused},
    lab::{self, RECORDINGS},
};

#[tokio::test]
async fn thresholds_outside_the_unit_interval() {
    let (_server, mut api) = quiet_lab().await;
    for recording in [&RECORDINGS[0], &RECORDINGS[6]] {
        lab::push(&mut api, lab::TASK, recording).await.unwrap();
    }
    let pretrain = api.submit(lab::TASK, lab::pretrain(2)).await.unwrap();
    let run = api.submit(lab::TASK, lab::score(&pretrain.result_id)).await.unwrap().result_id;
    for beta in [-0.1, 1.1, f64::NAN, f64::INFINITY] {
        let request = CreateDatasetRequest { score_run_id: run.clone(), selection: Some(lab::above(beta)) };
        refused(&api.datasets.create_dataset(request).await.unwrap_err(), Code::InvalidArgument, &["beta"]);
    }
    for fraction in [0.0, 1.1, f64::NAN] {
        let request = CreateDatasetRequest { score_run_id: run.clone(), selection: Some(lab::top(fraction)) };
        let error = api.datasets.create_dataset(request).await.unwrap_err();
        refused(&error, Code::InvalidArgument, &["selection.top_fraction"]);
    }
    let request = CreateDatasetRequest { score_run_id: run.clone(), selection: None };
    refused(&api.datasets.create_dataset(request).await.unwrap_err(), Code::InvalidArgument, &["selection"]);
    for (selections, words) in [
        (vec![], ["selections", "between 1 and 100"]),
        (vec![lab::above(0.5); 101], ["selections", "between 1 and 100"]),
        (vec![lab::above(0.5), lab::above(2.0)], ["selections[1].beta", "between 0 and 1"]),
    ] {
        let request = CountKeptRequest { score_run_id: run.clone(), selections, per_episode: false };
        refused(&api.scores.count_kept(request).await.unwrap_err(), Code::InvalidArgument, &words);
    }
    let request = CountKeptRequest { score_run_id: run.clone(), selections: vec![lab::above(0.5)], per_episode: false };
    refused(&api.scores.count_kept(request).await.unwrap_err(), Code::FailedPrecondition, &["job"]);
    let request = GetHistogramRequest { score_run_id: run.clone(), bins: 0, betas: vec![2.0] };
    refused(&api.scores.get_histogram(request).await.unwrap_err(), Code::InvalidArgument, &["betas"]);
    let request = GetHistogramRequest { score_run_id: run.clone(), bins: 0, betas: vec![] };
    refused(&api.scores.get_histogram(request).await.unwrap_err(), Code::FailedPrecondition, &["job"]);
    // The view may exist before the run; what it shows may not.
    let request = CreateDatasetRequest { score_run_id: run, selection: Some(lab::above(0.9)) };
    let dataset = api.datasets.create_dataset(request).await.unwrap().into_inner().dataset.unwrap();
    assert_eq!(dataset.kept_segments, None);
    let request = StreamSegmentsRequest { dataset_id: dataset.id, ..StreamSegmentsRequest::default() };
    refused(&api.datasets.stream_segments(request).await.unwrap_err(), Code::FailedPrecondition, &[]);
}

/// Every setting of the method that came after the first version names itself when it is wrong.
#[tokio::test]
async fn settings_that_cannot_be() {
    let (_server, mut api) = quiet_lab().await;
    for recording in [&RECORDINGS[0], &RECORDINGS[6]] {
        lab::push(&mut api, lab::TASK, recording).await.unwrap();
    }
    let encoder = api.submit(lab::TASK, lab::pretrain(2)).await.unwrap().result_id;
    let base = api.submit(lab::TASK, lab::score(&encoder)).await.unwrap().result_id;
    let pretrain = |spec| job_spec::Spec::Pretrain(spec);
    let score = |spec: ScoreSpec| job_spec::Spec::Score(ScoreSpec { encoder_id: encoder.clone(), ..spec });
    let data = || Some(train_spec::Data::ExpertsOf(encoder.clone()));
    let train = |spec: TrainSpec| job_spec::Spec::Train(TrainSpec { data: data(), ..spec });
    let shaken = Some(Augmentation { brightness: -1.0, ..Augmentation::default() });
    let act = Some(ActSpec { latent_size: Some(0), ..ActSpec::default() });
    let scale = Some(ModalityScale { image: f64::NAN, ..ModalityScale::default() });
    let rule = Some(RoleRule { imperfect_per_expert: f64::NAN, ..RoleRule::default() });
    let evaluate = EvaluateSpec {
        subject: Some(evaluate_spec::Subject::PolicyId("pol_01ARZ3NDEKTSV4RRFFQ69G5FAV".into())),
        ..EvaluateSpec::default()
    };
    for (spec, field) in [
        (pretrain(PretrainSpec { objectives: vec![77], ..Default::default() }), "spec.pretrain.objectives[0]"),
        (
            pretrain(PretrainSpec { augmentation: shaken, ..Default::default() }),
            "spec.pretrain.augmentation.brightness",
        ),
        (pretrain(PretrainSpec { rule, ..Default::default() }), "spec.pretrain.rule.imperfect_per_expert"),
        (score(ScoreSpec { scorer: 77, ..Default::default() }), "spec.score.scorer"),
        (score(ScoreSpec { similarity: 77, ..Default::default() }), "spec.score.similarity"),
        (score(ScoreSpec { normaliser: 77, ..Default::default() }), "spec.score.normaliser"),
        (score(ScoreSpec { modality_scale: scale, ..Default::default() }), "spec.score.modality_scale.image"),
        (score(ScoreSpec { extends: "run_7".into(), ..Default::default() }), "spec.score.extends"),
        (train(TrainSpec { policy: 77, ..Default::default() }), "spec.train.policy"),
        (train(TrainSpec { policy: PolicyKind::Act.into(), act, ..Default::default() }), "spec.train.act.latent_size"),
        (train(TrainSpec { act, ..Default::default() }), "spec.train.act"),
        (train(TrainSpec { preset: Preset::Base.into(), ..Default::default() }), "spec.train.preset"),
        (job_spec::Spec::Evaluate(EvaluateSpec { subject: None, ..evaluate.clone() }), "spec.evaluate.subject"),
        (job_spec::Spec::Evaluate(EvaluateSpec { seeds: vec![1, 1], ..evaluate.clone() }), "spec.evaluate.seeds"),
        (
            job_spec::Spec::Evaluate(EvaluateSpec { simulation: "stack_cube".into(), ..evaluate.clone() }),
            "spec.evaluate.simulation",
        ),
    ] {
        refused(&api.submit(lab::TASK, spec).await.unwrap_err(), Code::InvalidArgument, &[&format!("{field}: ")]);
    }
    let unknown = api.submit(lab::TASK, job_spec::Spec::Evaluate(evaluate)).await.unwrap_err();
    refused(&unknown, Code::NotFound, &["pol_01ARZ3NDEKTSV4RRFFQ69G5FAV"]);
    let extension = score(ScoreSpec { extends: base.clone(), ..Default::default() });
    refused(&api.submit(lab::TASK, extension).await.unwrap_err(), Code::FailedPrecondition, &[&base, "queued"]);
}
