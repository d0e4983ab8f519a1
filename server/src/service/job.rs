//! JobService: jobs in, their progress and results out.

use std::collections::HashSet;

use futures::TryStreamExt as _;
use gleaner_proto::v1::{self, job_service_server::JobService};
use tonic::{Request, Response};

use super::{
    Services,
    answer::{Reply, Responses, answer, change, responses},
};
use crate::{
    access::Caller,
    domain::{access::Role, id::JobId, job::Metric, order::JobFilter},
    error::Result,
    wire,
};

/// Longest part of a job's log in a response, in bytes.
const LOG: u64 = 16 << 10;

/// Room for one metric in a message, in bytes: about twice what one takes, because names are short.
const METRIC_BYTES: usize = 64;

/// Serves jobs.
pub(crate) struct JobApi(pub(crate) Services);

impl JobApi {
    /// The metrics of a job in order of arrival. Of more than `most`, those that a plot of about as many points has, so that
    /// a response fits a message; a watch of the job sends them all.
    pub(super) async fn metrics(&self, job: &JobId, most: usize) -> Result<Vec<Metric>> {
        let (store, count) = (&self.0.store, |count: usize| u32::try_from(count).unwrap_or(u32::MAX));
        let all = store.metrics(job, 0, count(most.saturating_add(1))).await?;
        if all.len() <= most {
            return Ok(all);
        }
        let names = all.iter().map(|metric| metric.name.as_str()).collect::<HashSet<_>>().len();
        drop(all);
        // Each name has its first and its newest value beside the extremes. Names that follow the first values were not
        // counted.
        let points = (most / 2 / names.max(1)).saturating_sub(2);
        let mut plotted = store.plotted_metrics(job, count(points)).await?;
        plotted.drain(..plotted.len().saturating_sub(most));
        Ok(plotted)
    }
}

#[tonic::async_trait]
impl JobService for JobApi {
    type WatchJobStream = Responses<v1::WatchJobResponse>;

    async fn submit_job(&self, request: Request<v1::SubmitJobRequest>) -> Reply<v1::SubmitJobResponse> {
        let caller = Caller::of(&request);
        change(request, async |request| {
            let (task, order, queueing) = wire::job::submit_request(request)?;
            may_give(&queueing.engine_options, caller)?;
            let task = self.0.store.task(&task).await?;
            let job = self.0.jobs.submit(&task.id, order, queueing).await?;
            Ok(v1::SubmitJobResponse { job: Some(wire::job::job(job)) })
        })
        .await
    }

    async fn submit_pipeline(&self, request: Request<v1::SubmitPipelineRequest>) -> Reply<v1::SubmitPipelineResponse> {
        let caller = Caller::of(&request);
        change(request, async |request| {
            let (task, pipeline, queueing) = wire::job::pipeline_request(request)?;
            may_give(&queueing.engine_options, caller)?;
            let task = self.0.store.task(&task).await?;
            let (jobs, dataset) = self.0.jobs.submit_pipeline(&task.id, &pipeline, queueing, None).await?;
            Ok(v1::SubmitPipelineResponse {
                jobs: jobs.into_iter().map(wire::job::job).collect(),
                dataset_id: dataset.map(String::from).unwrap_or_default(),
            })
        })
        .await
    }

    async fn get_job(&self, request: Request<v1::GetJobRequest>) -> Reply<v1::GetJobResponse> {
        answer(async {
            let job = self.0.store.job(&wire::job::job_id(&request.get_ref().job_id)?).await?;
            // The job is worth more than its log, which a failing disk may refuse.
            let log = self.0.jobs.log(&job.id, LOG).await.unwrap_or_else(|error| error.to_string());
            Ok(v1::GetJobResponse { job: Some(wire::job::job(job)), log })
        })
        .await
    }

    async fn list_jobs(&self, request: Request<v1::ListJobsRequest>) -> Reply<v1::ListJobsResponse> {
        answer(async {
            let wire::job::ListRequest { task, state, size, before } = wire::job::list_request(request.into_inner())?;
            let filter = JobFilter { task_id: self.0.task_or_all(&task).await?, state, kind: None };
            let (jobs, next) = self.0.store.jobs(&filter, before.as_ref(), size).await?;
            Ok(v1::ListJobsResponse {
                jobs: jobs.into_iter().map(wire::job::job).collect(),
                next_page_token: next.map(String::from).unwrap_or_default(),
            })
        })
        .await
    }

    async fn cancel_job(&self, request: Request<v1::CancelJobRequest>) -> Reply<v1::CancelJobResponse> {
        change(request, async |v1::CancelJobRequest { job_id }| {
            let job = self.0.jobs.cancel(&wire::job::job_id(&job_id)?).await?;
            Ok(v1::CancelJobResponse { job: Some(wire::job::job(job)) })
        })
        .await
    }

    async fn watch_job(&self, request: Request<v1::WatchJobRequest>) -> Reply<Self::WatchJobStream> {
        answer(async {
            let id = wire::job::job_id(&request.get_ref().job_id)?;
            Ok(responses(self.0.jobs.watch(&id).await?.map_ok(wire::job::watched)))
        })
        .await
    }

    async fn list_metrics(&self, request: Request<v1::ListMetricsRequest>) -> Reply<v1::ListMetricsResponse> {
        answer(async {
            let job = self.0.store.job(&wire::job::job_id(&request.get_ref().job_id)?).await?;
            let most = self.0.config.limits.max_message_bytes / METRIC_BYTES;
            let metrics = self.metrics(&job.id, most).await?;
            Ok(v1::ListMetricsResponse { metrics: metrics.into_iter().map(wire::job::metric).collect() })
        })
        .await
    }

    async fn list_kinds(&self, _: Request<v1::ListKindsRequest>) -> Reply<v1::ListKindsResponse> {
        Ok(Response::new(wire::kinds::list()))
    }
}

/// Options are the operator's part of a submission to the cluster.
pub(super) fn may_give(engine_options: &str, caller: Result<Caller>) -> Result<()> {
    if engine_options.is_empty() {
        return Ok(());
    }
    caller?.must_be(Role::Admin)
}
