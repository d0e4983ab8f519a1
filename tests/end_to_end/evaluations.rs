//! Evaluations: jobs in the embedded simulator, and reports of other simulators.

use gleaner_proto::v1::*;
use serde_json::json;
use tonic::Code;

use crate::support::{
    api::Api,
    lab,
    shared::{NAME, shared},
};

fn evaluate(subject: evaluate_spec::Subject) -> EvaluateSpec {
    EvaluateSpec {
        subject: Some(subject),
        settings: lab::settings(json!({"episodes": 34, "seeds": [0, 5], "max_steps": 6})),
    }
}

#[tokio::test]
async fn evaluation_is_repeatable_and_has_an_interval() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let mut made = Vec::new();
    for subject in
        [evaluate_spec::Subject::PolicyId(shared.policy.clone()), evaluate_spec::Subject::Deployment(NAME.into())]
    {
        let job = api.succeed(lab::TASK, job_spec::Spec::Evaluate(evaluate(subject))).await;
        assert_eq!((job.kind(), job.done, job.total), (JobKind::Evaluate, 68, 68));
        let evaluation = api.evaluation(&job.result_id).await;
        assert_eq!((&evaluation.job_id, &evaluation.policy_id), (&job.id, &shared.policy));
        let request = ListMetricsRequest { job_id: job.id.clone() };
        let metrics = api.jobs.list_metrics(request).await.unwrap().into_inner().metrics;
        let names: Vec<&str> = metrics.iter().map(|metric| metric.name.as_str()).collect();
        let looks = ["share_images", "share_camera_0", "share_camera_1", "share_proprioception", "share_history"];
        assert_eq!(names, looks, "what the policy looked at");
        assert!(metrics.iter().all(|metric| metric.step == 68 && metric.value.is_finite()), "{metrics:?}");
        made.push(evaluation);
    }
    let first = &made[0];
    assert_eq!(first.seeds, made[1].seeds, "the same policy and seeds give the same counts");
    assert_eq!(first.simulation, "pick_cube");
    assert_eq!(first.seeds.iter().map(|seed| (seed.seed, seed.episodes)).collect::<Vec<_>>(), [(0, 34), (5, 34)]);
    assert!(first.seeds.iter().all(|seed| seed.mean_steps > 0.0 && seed.mean_steps <= 6.0));
    assert_eq!(first.episodes, 68);
    assert_eq!((first.low, first.high), gleaner_core::statistics::wilson(first.successes, first.episodes));
    assert!(first.low <= first.success_rate && first.success_rate <= first.high);

    let request = ListEvaluationsRequest { policy_id: shared.policy.clone(), ..Default::default() };
    let listed = api.policies.list_evaluations(request).await.unwrap().into_inner().evaluations;
    let places: Vec<_> = made.iter().map(|one| listed.iter().position(|other| other == one).unwrap()).collect();
    assert!(places[1] < places[0], "newest first");
}

#[tokio::test]
async fn reported_evaluation_is_stored_with_its_policy() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let seed = SeedResult { seed: 3, episodes: 50, successes: 41, mean_steps: 0.0 };
    let report = ReportEvaluationRequest {
        policy_id: shared.policy.clone(),
        simulation: "metaworld/pick-place-v3".into(),
        seeds: vec![seed],
    };
    let kept = api.policies.report_evaluation(report.clone()).await.unwrap().into_inner().evaluation.unwrap();
    assert_eq!((kept.episodes, kept.successes, kept.job_id.as_str()), (50, 41, ""));
    assert!(kept.low < 0.82 && kept.high > 0.82);
    assert_eq!(api.evaluation(&kept.id).await, kept);

    let many = SeedResult { successes: 51, ..seed };
    let wrong = ReportEvaluationRequest { seeds: vec![many], ..report.clone() };
    let error = api.policies.report_evaluation(wrong).await.unwrap_err();
    assert!(error.code() == Code::InvalidArgument && error.message().contains("seeds[0].successes"), "{error}");
    let unknown = ReportEvaluationRequest { policy_id: "pol_01ARZ3NDEKTSV4RRFFQ69G5FAV".into(), ..report };
    assert_eq!(api.policies.report_evaluation(unknown).await.unwrap_err().code(), Code::NotFound);
    let unknown = GetEvaluationRequest { evaluation_id: "eval_01ARZ3NDEKTSV4RRFFQ69G5FAV".into() };
    assert_eq!(api.policies.get_evaluation(unknown).await.unwrap_err().code(), Code::NotFound);
}

#[tokio::test]
async fn evaluation_can_be_cancelled() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let subject = evaluate_spec::Subject::PolicyId(shared.policy.clone());
    let long =
        lab::with(job_spec::Spec::Evaluate(evaluate(subject)), json!({"episodes": 100_000, "max_steps": 10_000}));
    let job = api.submit(lab::TASK, long).await.unwrap();
    api.watch_until(&job.id, |job| job.message == "evaluating").await;
    api.jobs.cancel_job(CancelJobRequest { job_id: job.id.clone() }).await.unwrap();
    assert_eq!(api.watch(&job.id).await.state(), JobState::Cancelled);
    let request = GetEvaluationRequest { evaluation_id: job.result_id };
    assert_eq!(api.policies.get_evaluation(request).await.unwrap_err().code(), Code::FailedPrecondition);
}
