//! A chain is submitted once, against an in-process service that loses its first responses.

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

/// The chains by their keys, and the number of responses that are lost.
#[derive(Default)]
struct Queue {
    chains: HashMap<String, Vec<Job>>,
    lost: usize,
    calls: usize,
}

#[derive(Clone, Default)]
struct Fake(Arc<Mutex<Queue>>);

fn unused<T>() -> Reply<T> {
    Err(Status::failed_precondition("this fake takes pipelines only"))
}

#[tonic::async_trait]
impl JobService for Fake {
    type WatchJobStream = Pin<Box<dyn Stream<Item = std::result::Result<WatchJobResponse, Status>> + Send>>;

    async fn submit_pipeline(&self, request: Request<SubmitPipelineRequest>) -> Reply<SubmitPipelineResponse> {
        let SubmitPipelineRequest { task, key, .. } = request.into_inner();
        let mut queue = self.0.lock().unwrap();
        queue.calls += 1;
        if task == "absent" {
            return Err(Status::not_found("no task absent"));
        }
        let id = format!("job_{}", queue.chains.len());
        let jobs = queue.chains.entry(key).or_insert_with(|| vec![Job { id, ..Job::default() }]).clone();
        if queue.lost > 0 {
            queue.lost -= 1;
            return Err(Status::unavailable("going down"));
        }
        Ok(Response::new(SubmitPipelineResponse { jobs, dataset_id: String::new() }))
    }

    async fn submit_job(&self, _: Request<SubmitJobRequest>) -> Reply<SubmitJobResponse> {
        unused()
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

/// Submits the requests to a service that loses its first response.
async fn submit(requests: &[SubmitPipelineRequest]) -> (Vec<Result<SubmitPipelineResponse>>, Fake) {
    let fake = Fake::default();
    fake.0.lock().unwrap().lost = 1;
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let url = format!("http://{}", listener.local_addr().unwrap());
    let server = tonic::transport::Server::builder().add_service(JobServiceServer::new(fake.clone()));
    let serving = tokio::spawn(server.serve_with_incoming(TcpListenerStream::new(listener)));
    let client = Client::connect(&url, None).await.unwrap();
    let mut replies = Vec::new();
    for request in requests {
        replies.push(client.submit_pipeline(request.clone()).await);
    }
    serving.abort();
    (replies, fake)
}

#[tokio::test]
async fn a_chain_whose_response_is_lost_is_queued_once_and_a_second_call_queues_another() {
    let request = SubmitPipelineRequest::default();
    let (replies, fake) = submit(&[request.clone(), request]).await;
    let ids: Vec<String> = replies.into_iter().map(|reply| reply.unwrap().jobs.remove(0).id).collect();
    assert_eq!(ids, ["job_0", "job_1"], "the repeat found the first chain");
    let queue = fake.0.lock().unwrap();
    assert_eq!((queue.calls, queue.chains.len()), (3, 2));
}

#[tokio::test]
async fn a_key_of_the_caller_is_sent_and_a_rejection_is_final() {
    let own = SubmitPipelineRequest { key: "mine".into(), ..SubmitPipelineRequest::default() };
    let absent = SubmitPipelineRequest { task: "absent".into(), ..SubmitPipelineRequest::default() };
    let (replies, fake) = submit(&[absent, own]).await;
    assert_eq!(replies[0].as_ref().unwrap_err().code(), Some(Code::NotFound));
    assert!(replies[1].is_ok());
    let queue = fake.0.lock().unwrap();
    assert_eq!((queue.calls, queue.chains.len()), (3, 1));
    assert!(queue.chains.contains_key("mine"));
}
