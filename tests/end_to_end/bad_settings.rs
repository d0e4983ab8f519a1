//! Invalid settings: each is rejected with its path and the fix before a job is queued.

use gleaner_proto::v1::*;
use serde_json::json;
use tonic::Code;

use crate::support::{
    command::server_text,
    errors::expect_error,
    lab::{self, RECORDINGS},
};

#[tokio::test]
async fn thresholds_outside_the_unit_interval_are_rejected() {
    let (_server, mut api) = lab::idle().await;
    for recording in [&RECORDINGS[0], &RECORDINGS[6]] {
        lab::push(&mut api, lab::TASK, recording).await.unwrap();
    }
    let pretrain = api.submit(lab::TASK, lab::pretrain(2)).await.unwrap();
    let run = api.submit(lab::TASK, lab::score(&pretrain.result_id)).await.unwrap().result_id;
    for beta in [-0.1, 1.1, f64::NAN, f64::INFINITY] {
        let request = CreateDatasetRequest { score_run_id: run.clone(), selection: Some(lab::above(beta)) };
        expect_error(&api.datasets.create_dataset(request).await.unwrap_err(), Code::InvalidArgument, &["beta"]);
    }
    for fraction in [0.0, 1.1, f64::NAN] {
        let request = CreateDatasetRequest { score_run_id: run.clone(), selection: Some(lab::top(fraction)) };
        let error = api.datasets.create_dataset(request).await.unwrap_err();
        expect_error(&error, Code::InvalidArgument, &["selection.top_fraction"]);
    }
    // Without a rule, an unfinished run decides by its normaliser.
    let request = CreateDatasetRequest { score_run_id: run.clone(), selection: None };
    let dataset = api.datasets.create_dataset(request).await.unwrap().into_inner().dataset.unwrap();
    assert_eq!(dataset.selection, Some(lab::above(0.5)));
    for (selections, words) in [
        (vec![], ["selections", "between 1 and 100"]),
        (vec![lab::above(0.5); 101], ["selections", "between 1 and 100"]),
        (vec![lab::above(0.5), lab::above(2.0)], ["selections[1].beta", "between 0 and 1"]),
    ] {
        let request = CountKeptRequest { score_run_id: run.clone(), selections, per_episode: false };
        expect_error(&api.scores.count_kept(request).await.unwrap_err(), Code::InvalidArgument, &words);
    }
    let request = CountKeptRequest { score_run_id: run.clone(), selections: vec![lab::above(0.5)], per_episode: false };
    expect_error(&api.scores.count_kept(request).await.unwrap_err(), Code::FailedPrecondition, &["job"]);
    let request = GetHistogramRequest { score_run_id: run.clone(), bins: 0, betas: vec![2.0] };
    expect_error(&api.scores.get_histogram(request).await.unwrap_err(), Code::InvalidArgument, &["betas"]);
    let request = GetHistogramRequest { score_run_id: run.clone(), bins: 0, betas: vec![] };
    expect_error(&api.scores.get_histogram(request).await.unwrap_err(), Code::FailedPrecondition, &["job"]);
    // A dataset can be created before its run has ended; its segments cannot be read.
    let request = CreateDatasetRequest { score_run_id: run, selection: Some(lab::above(0.9)) };
    let dataset = api.datasets.create_dataset(request).await.unwrap().into_inner().dataset.unwrap();
    assert_eq!(dataset.kept_segments, None);
    let request = StreamSegmentsRequest { dataset_id: dataset.id, ..StreamSegmentsRequest::default() };
    expect_error(&api.datasets.stream_segments(request).await.unwrap_err(), Code::FailedPrecondition, &[]);
}

#[tokio::test]
async fn invalid_settings_are_rejected_with_their_path() {
    let (_server, mut api) = lab::idle().await;
    for recording in [&RECORDINGS[0], &RECORDINGS[6]] {
        lab::push(&mut api, lab::TASK, recording).await.unwrap();
    }
    let encoder = api.submit(lab::TASK, lab::pretrain(2)).await.unwrap().result_id;
    let base = api.submit(lab::TASK, lab::score(&encoder)).await.unwrap().result_id;
    let pretrain = |given| lab::with(lab::pretrain(2), given);
    let score = |given| lab::with(lab::score(&encoder), given);
    let train = |given| lab::with(lab::train(train_spec::Data::ExpertsOf(encoder.clone()), 2), given);
    let rule = Some(RoleRule { imperfect_per_expert: f64::NAN, ..RoleRule::default() });
    let subject = Some(evaluate_spec::Subject::PolicyId("pol_01ARZ3NDEKTSV4RRFFQ69G5FAV".into()));
    let evaluate =
        |given| job_spec::Spec::Evaluate(EvaluateSpec { subject: subject.clone(), settings: lab::settings(given) });
    let extends = |run: &str| {
        let (encoder_id, extends) = (encoder.clone(), run.to_owned());
        job_spec::Spec::Score(ScoreSpec { encoder_id, extends, ..ScoreSpec::default() })
    };
    for (spec, field) in [
        (pretrain(json!({"objectives": ["x"]})), "spec.pretrain.settings.objectives"),
        (pretrain(json!({"brightness": -1.0})), "spec.pretrain.settings.brightness"),
        (pretrain(json!({"no such setting": 1})), "spec.pretrain.settings.no such setting"),
        (
            job_spec::Spec::Pretrain(PretrainSpec { rule, ..Default::default() }),
            "spec.pretrain.rule.imperfect_per_expert",
        ),
        (score(json!({"scorer": "x"})), "spec.score.settings.scorer"),
        (score(json!({"similarity": 77})), "spec.score.settings.similarity"),
        (score(json!({"normaliser": "x"})), "spec.score.settings.normaliser"),
        (score(json!({"scale": [-1, 1, 1]})), "spec.score.settings.scale"),
        (score(json!({"scale": {"deep": [[[]]]}})), "spec.score.settings.scale"),
        (extends("run_7"), "spec.score.extends"),
        (train(json!({"policy": "x"})), "spec.train.settings.policy"),
        (train(json!({"policy": "act", "latent_size": 0})), "spec.train.settings.latent_size"),
        (train(json!({"latent_size": 16})), "spec.train.settings.latent_size"),
        (train(json!({"preset": "base"})), "spec.train.settings.preset"),
        (job_spec::Spec::Evaluate(EvaluateSpec::default()), "spec.evaluate.subject"),
        (evaluate(json!({"seeds": [1, 1]})), "spec.evaluate.settings.seeds"),
        (evaluate(json!({"simulation": "stack_cube"})), "spec.evaluate.settings.simulation"),
    ] {
        expect_error(&api.submit(lab::TASK, spec).await.unwrap_err(), Code::InvalidArgument, &[&format!("{field}: ")]);
    }
    let unknown = api.submit(lab::TASK, evaluate(json!({}))).await.unwrap_err();
    expect_error(&unknown, Code::NotFound, &["pol_01ARZ3NDEKTSV4RRFFQ69G5FAV"]);
    let extension = extends(&base);
    expect_error(&api.submit(lab::TASK, extension).await.unwrap_err(), Code::FailedPrecondition, &[&base, "queued"]);
}

#[tokio::test]
async fn an_address_that_is_taken_is_refused_with_its_flag() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    for (flag, others) in [("--listen", vec![]), ("--web-listen", vec!["--listen", "127.0.0.1:0"])] {
        let words = [vec!["serve", flag, &address], others].concat();
        let folder = tempfile::tempdir().unwrap();
        let (started, text) = server_text(&words, &folder.path().join("data")).await;
        assert!(!started && text.contains(&format!("{flag}: cannot listen on {address}: ")), "{text}");
        assert!(text.contains("has this address: name another"), "{text}");
    }
}
