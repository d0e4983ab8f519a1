//! ScheduleService: pipelines that start by themselves.

use gleaner_proto::v1::{self, schedule_service_server::ScheduleService};
use tonic::{Request, Response};

use super::Services;
use crate::{
    domain::time::Millis,
    error::Result,
    wire::{self, status::from_error},
};

/// Serves schedules.
pub(crate) struct Schedules(pub(crate) Services);

impl Schedules {
    async fn create(&self, request: v1::CreateScheduleRequest) -> Result<v1::CreateScheduleResponse> {
        let (task, schedule) = wire::schedule::create_request(request, Millis::now())?;
        let task = self.0.store.task(&task).await?;
        let schedule = self.0.jobs.add_schedule(&schedule.of(task.id)).await?;
        Ok(v1::CreateScheduleResponse { schedule: Some(wire::schedule::schedule(schedule)) })
    }

    async fn list(&self, task: &str) -> Result<v1::ListSchedulesResponse> {
        let task = if task.is_empty() { None } else { Some(self.0.store.task(task).await?.id) };
        let schedules = self.0.store.schedules(task.as_ref()).await?;
        Ok(v1::ListSchedulesResponse { schedules: schedules.into_iter().map(wire::schedule::schedule).collect() })
    }

    async fn pause(&self, request: v1::PauseScheduleRequest) -> Result<v1::PauseScheduleResponse> {
        let v1::PauseScheduleRequest { schedule_id, paused } = request;
        let id = wire::schedule::schedule_id(&schedule_id)?;
        let schedule = self.0.jobs.pause_schedule(&id, paused).await?;
        Ok(v1::PauseScheduleResponse { schedule: Some(wire::schedule::schedule(schedule)) })
    }

    async fn delete(&self, id: &str) -> Result<v1::DeleteScheduleResponse> {
        self.0.store.delete_schedule(&wire::schedule::schedule_id(id)?).await?;
        Ok(v1::DeleteScheduleResponse {})
    }
}

#[tonic::async_trait]
impl ScheduleService for Schedules {
    async fn create_schedule(
        &self,
        request: Request<v1::CreateScheduleRequest>,
    ) -> tonic::Result<Response<v1::CreateScheduleResponse>> {
        self.create(request.into_inner()).await.map(Response::new).map_err(from_error)
    }

    async fn list_schedules(
        &self,
        request: Request<v1::ListSchedulesRequest>,
    ) -> tonic::Result<Response<v1::ListSchedulesResponse>> {
        self.list(&request.into_inner().task).await.map(Response::new).map_err(from_error)
    }

    async fn pause_schedule(
        &self,
        request: Request<v1::PauseScheduleRequest>,
    ) -> tonic::Result<Response<v1::PauseScheduleResponse>> {
        self.pause(request.into_inner()).await.map(Response::new).map_err(from_error)
    }

    async fn delete_schedule(
        &self,
        request: Request<v1::DeleteScheduleRequest>,
    ) -> tonic::Result<Response<v1::DeleteScheduleResponse>> {
        self.delete(&request.into_inner().schedule_id).await.map(Response::new).map_err(from_error)
    }
}
