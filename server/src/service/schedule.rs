//! ScheduleService: pipelines that start automatically.

use gleaner_proto::v1::{self, schedule_service_server::ScheduleService};
use tonic::Request;

use super::{
    Services,
    answer::{Reply, answer, change},
    job::may_give,
};
use crate::{access::Caller, domain::time::Millis, wire};

/// Serves schedules.
pub(crate) struct ScheduleApi(pub(crate) Services);

#[tonic::async_trait]
impl ScheduleService for ScheduleApi {
    async fn create_schedule(&self, request: Request<v1::CreateScheduleRequest>) -> Reply<v1::CreateScheduleResponse> {
        let caller = Caller::of(&request);
        change(request, async |request| {
            let (task, schedule) = wire::schedule::create_request(request, Millis::now())?;
            may_give(schedule.engine_options(), caller)?;
            let task = self.0.store.task(&task).await?;
            let schedule = self.0.jobs.add_schedule(&schedule.of(task.id)).await?;
            Ok(v1::CreateScheduleResponse { schedule: Some(wire::schedule::schedule(schedule)) })
        })
        .await
    }

    async fn list_schedules(&self, request: Request<v1::ListSchedulesRequest>) -> Reply<v1::ListSchedulesResponse> {
        answer(async {
            let wire::schedule::ListRequest { task, size, after } = wire::schedule::list_request(request.into_inner())?;
            let task = self.0.task_or_all(&task).await?;
            let (schedules, next) = self.0.store.schedules(task.as_ref(), after.as_ref(), size).await?;
            Ok(v1::ListSchedulesResponse {
                schedules: schedules.into_iter().map(wire::schedule::schedule).collect(),
                next_page_token: next.map(String::from).unwrap_or_default(),
            })
        })
        .await
    }

    async fn pause_schedule(&self, request: Request<v1::PauseScheduleRequest>) -> Reply<v1::PauseScheduleResponse> {
        change(request, async |v1::PauseScheduleRequest { schedule_id, paused }| {
            let id = wire::schedule::schedule_id(&schedule_id)?;
            let schedule = self.0.jobs.pause_schedule(&id, paused).await?;
            Ok(v1::PauseScheduleResponse { schedule: Some(wire::schedule::schedule(schedule)) })
        })
        .await
    }

    async fn delete_schedule(&self, request: Request<v1::DeleteScheduleRequest>) -> Reply<v1::DeleteScheduleResponse> {
        change(request, async |v1::DeleteScheduleRequest { schedule_id }| {
            self.0.store.delete_schedule(&wire::schedule::schedule_id(&schedule_id)?).await?;
            Ok(v1::DeleteScheduleResponse {})
        })
        .await
    }
}
