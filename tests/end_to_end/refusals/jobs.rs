//! JobService. Invalid settings of a job are in `bad_settings` and, field by field, beside the conversions.

use gleaner_proto::v1::*;
use tonic::Code;

use crate::support::{
    api::Api,
    errors::{absent_id, expect_alive, expect_error, expect_errors},
    lab,
    shared::shared,
};

#[tokio::test]
async fn invalid_jobs_are_rejected() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let good = SubmitJobRequest {
        task: lab::TASK.into(),
        spec: Some(JobSpec { spec: Some(lab::pretrain(2)) }),
        ..SubmitJobRequest::default()
    };
    let with = |change: fn(&mut SubmitJobRequest)| {
        let mut request = good.clone();
        change(&mut request);
        request
    };
    expect_errors!(api.jobs:
        submit_job(with(|r| r.task.clear())) => InvalidArgument ["task: "];
        submit_job(with(|r| r.task = "absent".into())) => NotFound ["absent"];
        submit_job(with(|r| r.spec = None)) => InvalidArgument ["spec: "];
        submit_job(with(|r| r.spec = Some(JobSpec { spec: None }))) => InvalidArgument ["spec: "];
        submit_job(with(|r| r.needs = vec!["x".into()])) => InvalidArgument ["needs[0]: "];
        submit_job(with(|r| r.needs = vec![absent_id("job"); 101])) => InvalidArgument ["needs: are 101"];
        submit_job(with(|r| r.needs = vec![absent_id("job")])) => NotFound [&absent_id("job")];
        submit_job(with(|r| r.max_attempts = Some(0))) => InvalidArgument ["max_attempts: "];
        submit_job(with(|r| r.max_attempts = Some(101))) => InvalidArgument ["max_attempts: "];
        submit_job(with(|r| r.key = "x".repeat(201))) => InvalidArgument ["key: "];
        submit_job(with(|r| r.key = "\0".into())) => InvalidArgument ["key: "];
        submit_job(with(|r| r.engine_options = "-p a\n#SBATCH -J b".into())) => InvalidArgument ["engine_options: ", "one line"];
        submit_job(with(|r| r.engine_options = "-p a --output=/x".into())) => InvalidArgument ["engine_options: --output=/x: "];
        submit_job(with(|r| r.engine_options = "-p gpu".into())) => FailedPrecondition ["engine_options: ", "--engine slurm"];
    );
    expect_alive(&mut api).await;
}

/// The inputs of a spec must exist and belong to the task.
#[tokio::test]
async fn jobs_with_unknown_inputs_are_rejected() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let pretrain = |snapshot: &str| {
        job_spec::Spec::Pretrain(PretrainSpec { snapshot_id: snapshot.to_owned(), ..PretrainSpec::default() })
    };
    let score = |encoder: &str, snapshot: &str, extends: &str| {
        job_spec::Spec::Score(ScoreSpec {
            encoder_id: encoder.to_owned(),
            snapshot_id: snapshot.to_owned(),
            extends: extends.to_owned(),
            ..ScoreSpec::default()
        })
    };
    let export = |dataset: &str, format| {
        job_spec::Spec::Export(ExportSpec {
            dataset_id: dataset.to_owned(),
            format,
            depth: dataset == "deep",
            video: dataset == "film",
            whole: false,
        })
    };
    let evaluate =
        |subject| job_spec::Spec::Evaluate(EvaluateSpec { subject: Some(subject), ..EvaluateSpec::default() });
    use evaluate_spec::Subject;
    use train_spec::Data;
    let encoder = shared.encoder.as_str();
    let wrong = |spec, field: &str| (spec, Code::InvalidArgument, field.to_owned());
    let absent = |spec, id: String| (spec, Code::NotFound, id);
    for (spec, code, words) in [
        wrong(pretrain("x"), "spec.pretrain.snapshot_id: "),
        absent(pretrain(&absent_id("snap")), absent_id("snap")),
        wrong(score("x", "", ""), "spec.score.encoder_id: "),
        absent(score(&absent_id("enc"), "", ""), absent_id("enc")),
        wrong(score(encoder, "x", ""), "spec.score.snapshot_id: "),
        absent(score(encoder, &absent_id("snap"), ""), absent_id("snap")),
        absent(score(encoder, "", &absent_id("run")), absent_id("run")),
        wrong(lab::train(Data::DatasetId("x".into()), 2), "spec.train.dataset_id: "),
        absent(lab::train(Data::DatasetId(absent_id("ds")), 2), absent_id("ds")),
        wrong(lab::train(Data::ExpertsOf("x".into()), 2), "spec.train.experts_of: "),
        absent(lab::train(Data::ExpertsOf(absent_id("enc")), 2), absent_id("enc")),
        wrong(lab::train(Data::ExpertsIn("x".into()), 2), "spec.train.experts_in: "),
        wrong(export("x", 1), "spec.export.dataset_id: "),
        wrong(export("deep", 1), "spec.export.depth: "),
        wrong(export("film", 3), "spec.export.video: "),
        absent(export(&absent_id("ds"), 1), absent_id("ds")),
        wrong(export(&absent_id("ds"), 9), "spec.export.format: "),
        wrong(evaluate(Subject::PolicyId("x".into())), "spec.evaluate.policy_id: "),
        absent(evaluate(Subject::PolicyId(absent_id("pol"))), absent_id("pol")),
        wrong(evaluate(Subject::Deployment("../x".into())), "spec.evaluate.deployment: "),
        absent(evaluate(Subject::Deployment("absent@prod".into())), "absent@prod".to_owned()),
    ] {
        expect_error(&api.submit(lab::TASK, spec).await.unwrap_err(), code, &[&words]);
    }
    expect_alive(&mut api).await;
}

/// A setting of no job.
fn unknown() -> Option<prost_types::Struct> {
    lab::settings(serde_json::json!({"no_such_setting": 1}))
}

#[tokio::test]
async fn incomplete_pipelines_are_rejected() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let whole = PipelineSpec {
        pretrain: Some(PretrainSpec::default()),
        score: true,
        beta: Some(0.9),
        train: Some(TrainSpec::default()),
        ..PipelineSpec::default()
    };
    let submit = |task: &str, change: fn(&mut PipelineSpec)| {
        let mut pipeline = whole.clone();
        change(&mut pipeline);
        SubmitPipelineRequest { task: task.to_owned(), pipeline: Some(pipeline), ..Default::default() }
    };
    let keyed = |key: String| SubmitPipelineRequest { key, ..submit(lab::TASK, |_| {}) };
    let data =
        |r: &mut PipelineSpec| r.train.as_mut().unwrap().data = Some(train_spec::Data::ExpertsOf(absent_id("enc")));
    let subject = |r: &mut PipelineSpec| {
        let subject = Some(evaluate_spec::Subject::PolicyId(absent_id("pol")));
        r.evaluate = Some(EvaluateSpec { subject, ..EvaluateSpec::default() });
    };
    let named = |r: &mut PipelineSpec| {
        r.scoring = Some(ScoreSpec { encoder_id: absent_id("enc"), ..ScoreSpec::default() });
    };
    expect_errors!(api.jobs:
        submit_pipeline(submit("", |_| {})) => InvalidArgument ["task: "];
        submit_pipeline(submit("absent", |_| {})) => NotFound ["absent"];
        submit_pipeline(SubmitPipelineRequest { task: lab::TASK.into(), ..Default::default() }) => InvalidArgument ["pipeline: "];
        submit_pipeline(submit(lab::TASK, |r| r.pretrain = None)) => InvalidArgument ["pipeline.pretrain: "];
        submit_pipeline(submit(lab::TASK, |r| r.pretrain.as_mut().unwrap().settings = unknown())) => InvalidArgument ["pipeline.pretrain.settings.no_such_setting: "];
        submit_pipeline(submit(lab::TASK, |r| r.score = false)) => InvalidArgument ["pipeline.beta: "];
        submit_pipeline(submit(lab::TASK, |r| r.beta = Some(2.0))) => InvalidArgument ["pipeline.beta: "];
        submit_pipeline(submit(lab::TASK, |r| r.beta = None)) => InvalidArgument ["pipeline.train: "];
        submit_pipeline(submit(lab::TASK, |r| r.top_fraction = Some(0.5))) => InvalidArgument ["pipeline.top_fraction: "];
        submit_pipeline(submit(lab::TASK, |r| (r.beta, r.top_fraction) = (None, Some(0.0)))) => InvalidArgument ["pipeline.top_fraction: "];
        submit_pipeline(submit(lab::TASK, |r| r.shape = Some(SelectionShape { phases: Some(0), ..Default::default() }))) => InvalidArgument ["pipeline.shape.phases: "];
        submit_pipeline(submit(lab::TASK, |r| (r.beta, r.train, r.shape) = (None, None, Some(SelectionShape::default())))) => InvalidArgument ["pipeline.shape: "];
        submit_pipeline(submit(lab::TASK, |r| r.train.as_mut().unwrap().settings = unknown())) => InvalidArgument ["pipeline.train.settings.no_such_setting: "];
        submit_pipeline(submit(lab::TASK, data)) => InvalidArgument ["pipeline.train.data: "];
        submit_pipeline(submit(lab::TASK, named)) => InvalidArgument ["pipeline.scoring.encoder_id: "];
        submit_pipeline(submit(lab::TASK, subject)) => InvalidArgument ["pipeline.evaluate.subject: "];
        submit_pipeline(keyed("x".repeat(201))) => InvalidArgument ["key: "];
        submit_pipeline(keyed("\0".into())) => InvalidArgument ["key: "];
    );
    expect_alive(&mut api).await;
}

#[tokio::test]
async fn unknown_jobs_are_rejected() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let list = |change: fn(&mut ListJobsRequest)| {
        let mut request = ListJobsRequest::default();
        change(&mut request);
        request
    };
    let unknown = absent_id("job");
    let all = api.jobs.list_jobs(ListJobsRequest::default()).await.unwrap().into_inner().jobs;
    let ended = all.iter().find(|job| job.state() == JobState::Succeeded).unwrap().id.clone();
    expect_errors!(api.jobs:
        get_job(GetJobRequest { job_id: "x".into() }) => InvalidArgument ["job_id: "];
        get_job(GetJobRequest { job_id: unknown.clone() }) => NotFound [&unknown];
        list_jobs(list(|r| r.task = "absent".into())) => NotFound ["absent"];
        list_jobs(list(|r| r.state = 77)) => InvalidArgument ["state: "];
        list_jobs(list(|r| r.page_size = 1001)) => InvalidArgument ["page_size: "];
        list_jobs(list(|r| r.page_token = "1".into())) => InvalidArgument ["page_token: is not a page token"];
        cancel_job(CancelJobRequest { job_id: "x".into() }) => InvalidArgument ["job_id: "];
        cancel_job(CancelJobRequest { job_id: unknown.clone() }) => NotFound [&unknown];
        cancel_job(CancelJobRequest { job_id: ended.clone() }) => FailedPrecondition [&ended];
        watch_job(WatchJobRequest { job_id: "x".into() }) => InvalidArgument ["job_id: "];
        watch_job(WatchJobRequest { job_id: unknown.clone() }) => NotFound [&unknown];
        list_metrics(ListMetricsRequest { job_id: "x".into() }) => InvalidArgument ["job_id: "];
        list_metrics(ListMetricsRequest { job_id: unknown.clone() }) => NotFound [&unknown];
    );
    expect_alive(&mut api).await;
}
