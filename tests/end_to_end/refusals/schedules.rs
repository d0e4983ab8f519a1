//! ScheduleService.

use create_schedule_request::Trigger;
use gleaner_proto::v1::*;

use crate::support::{
    api::Api,
    errors::{absent_id, expect_alive, expect_errors},
    lab,
    shared::shared,
};

#[tokio::test]
async fn invalid_schedules_are_rejected() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let good = CreateScheduleRequest {
        task: lab::TASK.into(),
        name: "never created".into(),
        trigger: Some(Trigger::Cron("0 3 * * *".into())),
        pipeline: Some(PipelineSpec { pretrain: Some(PretrainSpec::default()), ..PipelineSpec::default() }),
        engine_options: String::new(),
    };
    let with = |change: fn(&mut CreateScheduleRequest)| {
        let mut request = good.clone();
        change(&mut request);
        request
    };
    expect_errors!(api.schedules:
        create_schedule(with(|r| r.task.clear())) => InvalidArgument ["task: "];
        create_schedule(with(|r| r.task = "absent".into())) => NotFound ["absent"];
        create_schedule(with(|r| r.name.clear())) => InvalidArgument ["name: "];
        create_schedule(with(|r| r.name = "x".repeat(256))) => InvalidArgument ["name: "];
        create_schedule(with(|r| r.trigger = None)) => InvalidArgument ["trigger: "];
        create_schedule(with(|r| r.trigger = Some(Trigger::Cron(String::new())))) => InvalidArgument ["cron: "];
        create_schedule(with(|r| r.trigger = Some(Trigger::Cron("61 3 * * *".into())))) => InvalidArgument ["cron: "];
        // The 31st of February.
        create_schedule(with(|r| r.trigger = Some(Trigger::Cron("0 3 31 2 *".into())))) => InvalidArgument ["cron: "];
        create_schedule(with(|r| r.trigger = Some(Trigger::LabelledEpisodes(0)))) => InvalidArgument ["labelled_episodes: "];
        create_schedule(with(|r| r.pipeline = None)) => InvalidArgument ["pipeline: "];
        create_schedule(with(|r| r.pipeline = Some(PipelineSpec::default()))) => InvalidArgument ["pipeline.pretrain: "];
        list_schedules(ListSchedulesRequest { task: "absent".into(), ..Default::default() }) => NotFound ["absent"];
        list_schedules(ListSchedulesRequest { page_size: 1001, ..Default::default() }) => InvalidArgument ["page_size: "];
        list_schedules(ListSchedulesRequest { page_token: "1".into(), ..Default::default() }) => InvalidArgument ["page_token: is not a page token"];
        pause_schedule(PauseScheduleRequest { schedule_id: "x".into(), paused: true }) => InvalidArgument ["schedule_id: "];
        pause_schedule(PauseScheduleRequest { schedule_id: absent_id("sch"), paused: true }) => NotFound [&absent_id("sch")];
        delete_schedule(DeleteScheduleRequest { schedule_id: "x".into() }) => InvalidArgument ["schedule_id: "];
        delete_schedule(DeleteScheduleRequest { schedule_id: absent_id("sch") }) => NotFound [&absent_id("sch")];
    );
    // Its trigger is never reached, and the test deletes it.
    let twice = with(|r| (r.name, r.trigger) = ("twice".into(), Some(Trigger::LabelledEpisodes(u32::MAX))));
    let made = api.schedules.create_schedule(twice.clone()).await.unwrap().into_inner().schedule.unwrap();
    expect_errors!(api.schedules: create_schedule(twice) => AlreadyExists ["twice"];);
    api.schedules.delete_schedule(DeleteScheduleRequest { schedule_id: made.id }).await.unwrap();
    expect_alive(&mut api).await;
}
