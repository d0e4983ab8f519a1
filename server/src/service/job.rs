//! JobService: jobs in, their course out.

use std::pin::Pin;

use futures::{Stream, StreamExt as _};
use gleaner_proto::v1::{self, job_service_server::JobService};
use tonic::{Request, Response};

use super::Services;
use crate::{
    domain::order::JobFilter,
    error::Result,
    wire::{self, status::from_error},
};

/// Serves jobs.
pub(crate) struct JobsFace(pub(crate) Services);

impl JobsFace {
    async fn submit(&self, request: v1::SubmitJobRequest) -> Result<v1::SubmitJobResponse> {
        let (task, order, queueing) = wire::job::submit_request(request)?;
        let task = self.0.store.task(&task).await?;
        let job = self.0.jobs.submit(&task.id, order, queueing).await?;
        Ok(v1::SubmitJobResponse { job: Some(wire::job::job(job)) })
    }

    async fn submit_chain(&self, request: v1::SubmitPipelineRequest) -> Result<v1::SubmitPipelineResponse> {
        let (task, pipeline, priority) = wire::job::pipeline_request(request)?;
        let task = self.0.store.task(&task).await?;
        let (jobs, dataset) = self.0.jobs.submit_pipeline(&task.id, &pipeline, priority, None).await?;
        Ok(v1::SubmitPipelineResponse {
            jobs: jobs.into_iter().map(wire::job::job).collect(),
            dataset_id: dataset.map(String::from).unwrap_or_default(),
        })
    }

    async fn get(&self, id: &str) -> Result<v1::GetJobResponse> {
        let job = self.0.store.job(&wire::job::job_id(id)?).await?;
        Ok(v1::GetJobResponse { job: Some(wire::job::job(job)) })
    }

    async fn list(&self, request: v1::ListJobsRequest) -> Result<v1::ListJobsResponse> {
        let wire::job::ListRequest { task, state, size, before } = wire::job::list_request(request)?;
        let task_id = if task.is_empty() { None } else { Some(self.0.store.task(&task).await?.id) };
        let (jobs, next) = self.0.store.jobs(&JobFilter { task_id, state, kind: None }, before.as_ref(), size).await?;
        Ok(v1::ListJobsResponse {
            jobs: jobs.into_iter().map(wire::job::job).collect(),
            next_page_token: next.map(String::from).unwrap_or_default(),
        })
    }

    async fn cancel(&self, id: &str) -> Result<v1::CancelJobResponse> {
        let job = self.0.jobs.cancel(&wire::job::job_id(id)?).await?;
        Ok(v1::CancelJobResponse { job: Some(wire::job::job(job)) })
    }

    async fn metrics(&self, id: &str) -> Result<v1::ListMetricsResponse> {
        let job = self.0.store.job(&wire::job::job_id(id)?).await?;
        let metrics = self.0.store.metrics(&job.id, 0, u32::MAX).await?;
        Ok(v1::ListMetricsResponse { metrics: metrics.into_iter().map(wire::job::metric).collect() })
    }
}

#[tonic::async_trait]
impl JobService for JobsFace {
    type WatchJobStream = Pin<Box<dyn Stream<Item = tonic::Result<v1::WatchJobResponse>> + Send>>;

    async fn submit_job(
        &self,
        request: Request<v1::SubmitJobRequest>,
    ) -> tonic::Result<Response<v1::SubmitJobResponse>> {
        self.submit(request.into_inner()).await.map(Response::new).map_err(from_error)
    }

    async fn submit_pipeline(
        &self,
        request: Request<v1::SubmitPipelineRequest>,
    ) -> tonic::Result<Response<v1::SubmitPipelineResponse>> {
        self.submit_chain(request.into_inner()).await.map(Response::new).map_err(from_error)
    }

    async fn get_job(&self, request: Request<v1::GetJobRequest>) -> tonic::Result<Response<v1::GetJobResponse>> {
        self.get(&request.into_inner().job_id).await.map(Response::new).map_err(from_error)
    }

    async fn list_jobs(&self, request: Request<v1::ListJobsRequest>) -> tonic::Result<Response<v1::ListJobsResponse>> {
        self.list(request.into_inner()).await.map(Response::new).map_err(from_error)
    }

    async fn cancel_job(
        &self,
        request: Request<v1::CancelJobRequest>,
    ) -> tonic::Result<Response<v1::CancelJobResponse>> {
        self.cancel(&request.into_inner().job_id).await.map(Response::new).map_err(from_error)
    }

    async fn watch_job(&self, request: Request<v1::WatchJobRequest>) -> tonic::Result<Response<Self::WatchJobStream>> {
        let id = wire::job::job_id(&request.into_inner().job_id).map_err(from_error)?;
        let watched = self.0.jobs.watch(&id).await.map_err(from_error)?;
        Ok(Response::new(watched.map(|item| item.map(wire::job::watched).map_err(from_error)).boxed()))
    }

    async fn list_metrics(
        &self,
        request: Request<v1::ListMetricsRequest>,
    ) -> tonic::Result<Response<v1::ListMetricsResponse>> {
        self.metrics(&request.into_inner().job_id).await.map(Response::new).map_err(from_error)
    }

    async fn list_kinds(&self, _: Request<v1::ListKindsRequest>) -> tonic::Result<Response<v1::ListKindsResponse>> {
        Ok(Response::new(wire::kinds::list()))
    }
}
