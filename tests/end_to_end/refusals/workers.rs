//! WorkerService: every call requires the token of a running attempt.

use gleaner_proto::v1::{worker_service_client::WorkerServiceClient, *};
use tonic::{Code, Request, transport::Channel};

use crate::support::{
    api::Api,
    errors::{absent_id, expect_alive, expect_error, expect_errors},
    shared::shared,
};

#[tokio::test]
async fn workers_without_a_token_are_rejected() {
    struct Clients {
        workers: WorkerServiceClient<Channel>,
    }
    let shared = shared().await;
    let mut clients = Clients { workers: WorkerServiceClient::connect(shared.server.workers_url()).await.unwrap() };
    expect_errors!(clients.workers:
        get_assignment(GetAssignmentRequest {}) => Unauthenticated ["token"];
        stream_episodes(StreamEpisodesRequest {}) => Unauthenticated ["token"];
        stream_base_scores(StreamBaseScoresRequest {}) => Unauthenticated ["token"];
        report_meeting(ReportMeetingRequest::default()) => Unauthenticated ["token"];
        get_meeting(GetMeetingRequest {}) => Unauthenticated ["token"];
        report_progress(ReportProgressRequest::default()) => Unauthenticated ["token"];
        save_checkpoint(SaveCheckpointRequest::default()) => Unauthenticated ["token"];
        locate_blob(LocateBlobRequest::default()) => Unauthenticated ["token"];
        store_blob(StoreBlobRequest::default()) => Unauthenticated ["token"];
        complete_job(tokio_stream::iter([CompleteJobRequest::default()])) => Unauthenticated ["token"];
        fail_job(FailJobRequest::default()) => Unauthenticated ["token"];
    );
    for token in ["Bearer ", "Bearer x", "Basic abc", &format!("Bearer {}.{}", absent_id("job"), "0".repeat(64))] {
        let mut request = Request::new(GetAssignmentRequest {});
        request.metadata_mut().insert("authorization", token.parse().unwrap());
        let error = clients.workers.get_assignment(request).await.unwrap_err();
        expect_error(&error, Code::Unauthenticated, &["token"]);
    }
    expect_alive(&mut Api::connect(&shared.server).await).await;
}
