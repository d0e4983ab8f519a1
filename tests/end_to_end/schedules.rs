//! Schedules: a pipeline that starts once enough episodes are labelled, and cron expressions.

use gleaner_proto::v1::*;
use tonic::Code;

use crate::support::{
    api::Api,
    lab::{self, RECORDINGS},
    wait::until,
};

fn create(name: &str, trigger: create_schedule_request::Trigger) -> CreateScheduleRequest {
    let job_spec::Spec::Pretrain(pretrain) = lab::pretrain(2) else { unreachable!() };
    CreateScheduleRequest {
        task: lab::TASK.into(),
        name: name.into(),
        trigger: Some(trigger),
        pipeline: Some(PipelineSpec { pretrain: Some(pretrain), ..PipelineSpec::default() }),
        engine_options: String::new(),
    }
}

async fn schedules(api: &mut Api) -> Vec<Schedule> {
    let request = ListSchedulesRequest { task: lab::TASK.into(), ..Default::default() };
    api.schedules.list_schedules(request).await.unwrap().into_inner().schedules
}

#[tokio::test]
async fn new_labels_start_a_pipeline() {
    let (_server, mut api) = lab::with_task(&[]).await;
    let request = create("often", create_schedule_request::Trigger::LabelledEpisodes(3));
    api.schedules.create_schedule(request).await.unwrap();

    lab::push(&mut api, lab::TASK, &RECORDINGS[0]).await.unwrap();
    lab::push(&mut api, lab::TASK, &RECORDINGS[6]).await.unwrap();
    assert_eq!(schedules(&mut api).await[0].labelled_since, 2);
    lab::push(&mut api, lab::TASK, &RECORDINGS[7]).await.unwrap();

    let job = first_job(&mut api).await;
    assert_eq!(api.watch(&job.id).await.state(), JobState::Succeeded);
    let after = schedules(&mut api).await;
    assert_eq!((after[0].labelled_since, after[0].last_error.as_str()), (0, ""));
    assert!(after[0].last_run_time.is_some());
}

/// Waits for the first job, which an event inside the server starts after the label.
async fn first_job(api: &mut Api) -> Job {
    until("a job starts", async || {
        let request = ListJobsRequest { task: lab::TASK.into(), ..ListJobsRequest::default() };
        api.jobs.list_jobs(request).await.unwrap().into_inner().jobs.pop()
    })
    .await
}

#[tokio::test]
async fn cron_schedule_has_a_next_run_and_pauses() {
    let (_server, mut api) = lab::idle().await;
    let nightly = create("nightly", create_schedule_request::Trigger::Cron("30 2 * * *".into()));
    let schedule = api.schedules.create_schedule(nightly.clone()).await.unwrap().into_inner().schedule.unwrap();
    let next = schedule.next_run_time.unwrap().seconds;
    assert_eq!(next % 86_400, 2 * 3600 + 30 * 60, "half past two, UTC");

    let again = api.schedules.create_schedule(nightly).await.unwrap_err();
    assert_eq!(again.code(), Code::AlreadyExists, "{again}");
    let nonsense = create("x", create_schedule_request::Trigger::Cron("whenever".into()));
    let error = api.schedules.create_schedule(nonsense).await.unwrap_err();
    assert!(error.code() == Code::InvalidArgument && error.message().contains("cron"), "{error}");

    let pause = PauseScheduleRequest { schedule_id: schedule.id.clone(), paused: true };
    let paused = api.schedules.pause_schedule(pause).await.unwrap().into_inner().schedule.unwrap();
    assert!(paused.paused && paused.next_run_time.is_none());
    api.schedules.delete_schedule(DeleteScheduleRequest { schedule_id: schedule.id.clone() }).await.unwrap();
    assert!(schedules(&mut api).await.is_empty());
    let gone = api.schedules.delete_schedule(DeleteScheduleRequest { schedule_id: schedule.id }).await.unwrap_err();
    assert_eq!(gone.code(), Code::NotFound);
}
