//! ScheduleService.

use create_schedule_request::Trigger;
use gleaner_proto::v1::*;

use super::{alive, nobody, refuse};
use crate::{api::Api, lab, shared::shared};

type Spoil = fn(&mut CreateScheduleRequest);

#[tokio::test]
async fn schedules_that_cannot_be() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let good = CreateScheduleRequest {
        task: lab::TASK.into(),
        name: "never made".into(),
        trigger: Some(Trigger::Cron("0 3 * * *".into())),
        pipeline: Some(PipelineSpec { pretrain: Some(PretrainSpec::default()), ..PipelineSpec::default() }),
    };
    let with = |spoil: Spoil| {
        let mut request = good.clone();
        spoil(&mut request);
        request
    };
    refuse!(api.schedules:
        create_schedule(with(|r| r.task.clear())) => InvalidArgument ["task: "];
        create_schedule(with(|r| r.task = "nobody".into())) => NotFound ["nobody"];
        create_schedule(with(|r| r.name.clear())) => InvalidArgument ["name: "];
        create_schedule(with(|r| r.name = "x".repeat(256))) => InvalidArgument ["name: "];
        create_schedule(with(|r| r.trigger = None)) => InvalidArgument ["trigger: "];
        create_schedule(with(|r| r.trigger = Some(Trigger::Cron(String::new())))) => InvalidArgument ["cron: "];
        create_schedule(with(|r| r.trigger = Some(Trigger::Cron("61 3 * * *".into())))) => InvalidArgument ["cron: "];
        // A day that never comes.
        create_schedule(with(|r| r.trigger = Some(Trigger::Cron("0 3 31 2 *".into())))) => InvalidArgument ["cron: "];
        create_schedule(with(|r| r.trigger = Some(Trigger::LabelledEpisodes(0)))) => InvalidArgument ["labelled_episodes: "];
        create_schedule(with(|r| r.pipeline = None)) => InvalidArgument ["pipeline: "];
        create_schedule(with(|r| r.pipeline = Some(PipelineSpec::default()))) => InvalidArgument ["pipeline.pretrain: "];
        list_schedules(ListSchedulesRequest { task: "nobody".into() }) => NotFound ["nobody"];
        pause_schedule(PauseScheduleRequest { schedule_id: "x".into(), paused: true }) => InvalidArgument ["schedule_id: "];
        pause_schedule(PauseScheduleRequest { schedule_id: nobody("sch"), paused: true }) => NotFound [&nobody("sch")];
        delete_schedule(DeleteScheduleRequest { schedule_id: "x".into() }) => InvalidArgument ["schedule_id: "];
        delete_schedule(DeleteScheduleRequest { schedule_id: nobody("sch") }) => NotFound [&nobody("sch")];
    );
    // It counts labels that nobody gives meanwhile, and is gone at the end.
    let twice = with(|r| (r.name, r.trigger) = ("twice".into(), Some(Trigger::LabelledEpisodes(u32::MAX))));
    let made = api.schedules.create_schedule(twice.clone()).await.unwrap().into_inner().schedule.unwrap();
    refuse!(api.schedules: create_schedule(twice) => AlreadyExists ["twice"];);
    api.schedules.delete_schedule(DeleteScheduleRequest { schedule_id: made.id }).await.unwrap();
    alive(&mut api).await;
}
