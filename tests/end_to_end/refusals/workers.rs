//! WorkerService: without the token of a running attempt nobody gets in, whatever they ask.

use gleaner_proto::v1::{worker_service_client::WorkerServiceClient, *};
use tonic::{Code, Request, transport::Channel};

use super::{alive, nobody, refuse};
use crate::{api::Api, bad_input::refused, shared::shared};

#[tokio::test]
async fn workers_without_a_token() {
    struct Face {
        workers: WorkerServiceClient<Channel>,
    }
    let shared = shared().await;
    let mut face = Face { workers: WorkerServiceClient::connect(shared.server.workers_url()).await.unwrap() };
    refuse!(face.workers:
        get_assignment(GetAssignmentRequest {}) => Unauthenticated ["token"];
        stream_base_scores(StreamBaseScoresRequest {}) => Unauthenticated ["token"];
        report_progress(ReportProgressRequest::default()) => Unauthenticated ["token"];
        save_checkpoint(SaveCheckpointRequest::default()) => Unauthenticated ["token"];
        complete_job(tokio_stream::iter([CompleteJobRequest::default()])) => Unauthenticated ["token"];
        fail_job(FailJobRequest::default()) => Unauthenticated ["token"];
    );
    for token in ["Bearer ", "Bearer x", "Basic abc", &format!("Bearer {}.{}", nobody("job"), "0".repeat(64))] {
        let mut request = Request::new(GetAssignmentRequest {});
        request.metadata_mut().insert("authorization", token.parse().unwrap());
        let error = face.workers.get_assignment(request).await.unwrap_err();
        refused(&error, Code::Unauthenticated, &["token"]);
    }
    alive(&mut Api::connect(&shared.server).await).await;
}
