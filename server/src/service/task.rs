//! TaskService: tasks in and out.

use gleaner_proto::v1::{self, task_service_server::TaskService};
use tonic::{Request, Response};

use super::Services;
use crate::{
    access::Caller,
    domain::task::OutcomeCounts,
    error::Result,
    wire::{self, status::from_error},
};

/// Serves tasks.
pub(crate) struct Tasks(pub(crate) Services);

impl Tasks {
    async fn create(&self, request: v1::CreateTaskRequest) -> Result<v1::CreateTaskResponse> {
        let spec = wire::task::create_request(request, &self.0.config.limits.recordings.limits())?;
        let task = self.0.store.insert_task(&spec).await?;
        Ok(v1::CreateTaskResponse { task: Some(wire::task::task(task, OutcomeCounts::default())) })
    }

    async fn get(&self, caller: &Caller, task: &str) -> Result<v1::GetTaskResponse> {
        let task = self.0.store.task(task).await?;
        if caller.is_bound() {
            let deployments = self.0.store.deployments(Some(&task.id)).await?;
            caller.uses_one_of(deployments.iter().map(|deployment| deployment.name.as_str()))?;
        }
        let counts = self.0.store.outcome_counts(&task.id).await?;
        Ok(v1::GetTaskResponse { task: Some(wire::task::task(task, counts)) })
    }

    async fn list(&self) -> Result<v1::ListTasksResponse> {
        let tasks = self.0.store.tasks().await?;
        Ok(v1::ListTasksResponse {
            tasks: tasks.into_iter().map(|(task, counts)| wire::task::task(task, counts)).collect(),
        })
    }
}

#[tonic::async_trait]
impl TaskService for Tasks {
    async fn create_task(
        &self,
        request: Request<v1::CreateTaskRequest>,
    ) -> tonic::Result<Response<v1::CreateTaskResponse>> {
        self.create(request.into_inner()).await.map(Response::new).map_err(from_error)
    }

    async fn get_task(&self, request: Request<v1::GetTaskRequest>) -> tonic::Result<Response<v1::GetTaskResponse>> {
        let caller = Caller::of(&request).map_err(from_error)?;
        self.get(&caller, &request.into_inner().task).await.map(Response::new).map_err(from_error)
    }

    async fn list_tasks(
        &self,
        _request: Request<v1::ListTasksRequest>,
    ) -> tonic::Result<Response<v1::ListTasksResponse>> {
        self.list().await.map(Response::new).map_err(from_error)
    }
}
