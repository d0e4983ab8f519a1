//! Schedules: a pipeline that starts by itself once enough episodes are labelled; cron with its next run.

use gleaner_proto::v1::*;
use tonic::Code;

use crate::{
    api::Api,
    lab::{self, RECORDINGS},
    server::TestServer,
};

fn create(name: &str, trigger: create_schedule_request::Trigger) -> CreateScheduleRequest {
    let job_spec::Spec::Pretrain(pretrain) = lab::pretrain(2) else { unreachable!() };
    CreateScheduleRequest {
        task: lab::TASK.into(),
        name: name.into(),
        trigger: Some(trigger),
        pipeline: Some(PipelineSpec { pretrain: Some(pretrain), ..PipelineSpec::default() }),
    }
}

async fn schedules(api: &mut Api) -> Vec<Schedule> {
    api.schedules.list_schedules(ListSchedulesRequest { task: lab::TASK.into() }).await.unwrap().into_inner().schedules
}

#[tokio::test]
async fn new_labels_start_a_pipeline() {
    let server = TestServer::start().await;
    let mut api = Api::connect(&server).await;
    lab::create_task(&mut api).await;
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

/// The start follows the label by an event inside the server, so it may be a moment away.
async fn first_job(api: &mut Api) -> Job {
    let started = async {
        loop {
            let request = ListJobsRequest { task: lab::TASK.into(), ..ListJobsRequest::default() };
            if let Some(job) = api.jobs.list_jobs(request).await.unwrap().into_inner().jobs.pop() {
                return job;
            }
            tokio::task::yield_now().await;
        }
    };
    tokio::time::timeout(std::time::Duration::from_secs(60), started).await.expect("no job was started")
}

#[tokio::test]
async fn cron_shows_its_next_run_and_pauses() {
    let server = TestServer::start_with(&["--workers", "0"]).await;
    let mut api = Api::connect(&server).await;
    lab::create_task(&mut api).await;
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
