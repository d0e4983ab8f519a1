//! TaskService: tasks in and out.

use gleaner_proto::v1::{self, task_service_server::TaskService};
use tonic::Request;

use super::{
    Services,
    answer::{Reply, answer, change},
};
use crate::{access::Caller, domain::task::OutcomeCounts, wire};

/// Serves tasks.
pub(crate) struct TaskApi(pub(crate) Services);

#[tonic::async_trait]
impl TaskService for TaskApi {
    async fn create_task(&self, request: Request<v1::CreateTaskRequest>) -> Reply<v1::CreateTaskResponse> {
        change(request, async |request| {
            let spec = wire::task::create_request(request, &self.0.config.limits.recordings.limits())?;
            let task = self.0.store.insert_task(&spec).await?;
            Ok(v1::CreateTaskResponse { task: Some(wire::task::task(task, OutcomeCounts::default())) })
        })
        .await
    }

    async fn get_task(&self, request: Request<v1::GetTaskRequest>) -> Reply<v1::GetTaskResponse> {
        answer(async {
            let task = self.0.store.task(&request.get_ref().task).await?;
            let caller = Caller::of(&request)?;
            if caller.is_bound() {
                let deployments = self.0.store.deployments(Some(&task.id)).await?;
                caller.uses_one_of(deployments.iter().map(|deployment| deployment.name.as_str()))?;
            }
            let counts = self.0.store.outcome_counts(&task.id).await?;
            Ok(v1::GetTaskResponse { task: Some(wire::task::task(task, counts)) })
        })
        .await
    }

    async fn list_tasks(&self, request: Request<v1::ListTasksRequest>) -> Reply<v1::ListTasksResponse> {
        answer(async {
            let page = wire::task::list_request(request.into_inner())?;
            let (tasks, next) = self.0.store.tasks_page(&page).await?;
            let tasks = tasks.into_iter().map(|(task, counts)| wire::task::task(task, counts)).collect();
            Ok(v1::ListTasksResponse { tasks, next_page_token: wire::page::token(next) })
        })
        .await
    }

    async fn update_task(&self, request: Request<v1::UpdateTaskRequest>) -> Reply<v1::UpdateTaskResponse> {
        change(request, async |request| {
            let (name, spec) = wire::task::update_request(request, &self.0.config.limits.recordings.limits())?;
            let task = self.0.ingest.update_task(&name, &spec).await?;
            let counts = self.0.store.outcome_counts(&task.id).await?;
            Ok(v1::UpdateTaskResponse { task: Some(wire::task::task(task, counts)) })
        })
        .await
    }

    async fn delete_task(&self, request: Request<v1::DeleteTaskRequest>) -> Reply<v1::DeleteTaskResponse> {
        change(request, async |request| {
            let v1::DeleteTaskRequest { task } = request;
            self.0.ingest.delete_task(&task).await?;
            Ok(v1::DeleteTaskResponse {})
        })
        .await
    }
}
