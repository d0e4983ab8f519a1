//! A job and a chain are submitted once, against an in-process service that loses its first responses.

use std::collections::HashMap;
use std::pin::Pin;
use std::sync::{Arc, Mutex};

use futures::Stream;
use gleaner_proto::v1::job_service_server::{JobService, JobServiceServer};
use gleaner_proto::v1::*;
use tokio_stream::wrappers::TcpListenerStream;
use tonic::{Code, Request, Response, Status};

use super::*;

type Reply<T> = std::result::Result<Response<T>, Status>;

/// The jobs by their keys, and the number of responses that are lost.
#[derive(Default)]
struct Queue {
    jobs: HashMap<String, Job>,
    lost: usize,
    calls: usize,
}

#[derive(Clone, Default)]
struct Fake(Arc<Mutex<Queue>>);

fn unused<T>() -> Reply<T> {
    Err(Status::failed_precondition("this fake takes jobs and pipelines only"))
}

impl Fake {
    /// The job of this key, of a call whose response may be lost.
    fn queued(&self, task: &str, key: String) -> std::result::Result<Job, Status> {
        let mut queue = self.0.lock().unwrap();
        queue.calls += 1;
        if task == "absent" {
            return Err(Status::not_found("no task absent"));
        }
        let id = format!("job_{}", queue.jobs.len());
        let job = queue.jobs.entry(key.clone()).or_insert_with(|| Job { id, key, ..Job::default() }).clone();
        if queue.lost > 0 {
            queue.lost -= 1;
            return Err(Status::unavailable("going down"));
        }
        Ok(job)
    }
}

#[tonic::async_trait]
impl JobService for Fake {
    type WatchJobStream = Pin<Box<dyn Stream<Item = std::result::Result<WatchJobResponse, Status>> + Send>>;

    async fn submit_pipeline(&self, request: Request<SubmitPipelineRequest>) -> Reply<SubmitPipelineResponse> {
        let SubmitPipelineRequest { task, key, .. } = request.into_inner();
        let jobs = vec![self.queued(&task, key)?];
        Ok(Response::new(SubmitPipelineResponse { jobs, dataset_id: String::new() }))
    }

    async fn submit_job(&self, request: Request<SubmitJobRequest>) -> Reply<SubmitJobResponse> {
        let SubmitJobRequest { task, key, .. } = request.into_inner();
        Ok(Response::new(SubmitJobResponse { job: Some(self.queued(&task, key)?) }))
    }

    async fn get_job(&self, _: Request<GetJobRequest>) -> Reply<GetJobResponse> {
        unused()
    }

    async fn list_jobs(&self, _: Request<ListJobsRequest>) -> Reply<ListJobsResponse> {
        unused()
    }

    async fn cancel_job(&self, _: Request<CancelJobRequest>) -> Reply<CancelJobResponse> {
        unused()
    }

    async fn watch_job(&self, _: Request<WatchJobRequest>) -> Reply<Self::WatchJobStream> {
        unused()
    }

    async fn list_metrics(&self, _: Request<ListMetricsRequest>) -> Reply<ListMetricsResponse> {
        unused()
    }

    async fn list_kinds(&self, _: Request<ListKindsRequest>) -> Reply<ListKindsResponse> {
        unused()
    }
}

/// A client of a service that loses its first response.
async fn connected() -> (Client, Fake) {
    let fake = Fake::default();
    fake.0.lock().unwrap().lost = 1;
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let url = format!("http://{}", listener.local_addr().unwrap());
    let server = tonic::transport::Server::builder().add_service(JobServiceServer::new(fake.clone()));
    tokio::spawn(server.serve_with_incoming(TcpListenerStream::new(listener)));
    (Client::connect(&url, None).await.unwrap(), fake)
}

/// The number of calls that the service has received, and of jobs that it has.
fn counts(fake: &Fake) -> (usize, usize) {
    let queue = fake.0.lock().unwrap();
    (queue.calls, queue.jobs.len())
}

#[tokio::test]
async fn a_job_whose_response_is_lost_is_queued_once_and_a_second_call_queues_another() {
    let (client, fake) = connected().await;
    let mut ids = Vec::new();
    for _ in 0..2 {
        ids.push(client.submit_job(SubmitJobRequest::default()).await.unwrap().id);
    }
    assert_eq!(ids, ["job_0", "job_1"], "the repeat found the first job");
    assert_eq!(counts(&fake), (3, 2));
}

#[tokio::test]
async fn a_chain_whose_response_is_lost_is_queued_once_and_a_second_call_queues_another() {
    let (client, fake) = connected().await;
    let mut ids = Vec::new();
    for _ in 0..2 {
        ids.push(client.submit_pipeline(SubmitPipelineRequest::default()).await.unwrap().jobs.remove(0).id);
    }
    assert_eq!(ids, ["job_0", "job_1"], "the repeat found the first chain");
    assert_eq!(counts(&fake), (3, 2));
}

#[tokio::test]
async fn a_key_of_the_caller_is_sent_and_a_rejection_is_final() {
    let (client, fake) = connected().await;
    let absent = SubmitJobRequest { task: "absent".into(), ..SubmitJobRequest::default() };
    assert_eq!(client.submit_job(absent).await.unwrap_err().code(), Some(Code::NotFound));
    let absent = SubmitPipelineRequest { task: "absent".into(), ..SubmitPipelineRequest::default() };
    assert_eq!(client.submit_pipeline(absent).await.unwrap_err().code(), Some(Code::NotFound));
    assert_eq!(counts(&fake), (2, 0));
    let own = SubmitJobRequest { key: "mine".into(), ..SubmitJobRequest::default() };
    assert_eq!(client.submit_job(own).await.unwrap().key, "mine");
    let own = SubmitPipelineRequest { key: "my chain".into(), ..SubmitPipelineRequest::default() };
    assert_eq!(client.submit_pipeline(own).await.unwrap().jobs[0].key, "my chain");
    assert_eq!(counts(&fake), (5, 2));
}
