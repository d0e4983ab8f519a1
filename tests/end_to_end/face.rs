//! What every gRPC client expects of a server: health by service, and reflection.

use tonic::transport::Channel;
use tonic_health::pb::{HealthCheckRequest, health_check_response::ServingStatus, health_client::HealthClient};
use tonic_reflection::pb::v1::{
    ServerReflectionRequest, server_reflection_client::ServerReflectionClient,
    server_reflection_request::MessageRequest, server_reflection_response::MessageResponse,
};

use crate::server::TestServer;

const SERVICES: [&str; 9] = [
    "gleaner.v1.TaskService",
    "gleaner.v1.EpisodeService",
    "gleaner.v1.SnapshotService",
    "gleaner.v1.JobService",
    "gleaner.v1.ScheduleService",
    "gleaner.v1.ScoreService",
    "gleaner.v1.DatasetService",
    "gleaner.v1.PolicyService",
    "inference.GRPCInferenceService",
];

#[tokio::test]
async fn every_service_is_healthy_and_reflected() {
    let server = TestServer::start_with(&["--workers", "0"]).await;
    let channel = Channel::from_shared(server.url().to_owned()).unwrap().connect().await.unwrap();

    let request = ServerReflectionRequest {
        host: String::new(),
        message_request: Some(MessageRequest::ListServices(String::new())),
    };
    let mut answers = ServerReflectionClient::new(channel.clone())
        .server_reflection_info(tokio_stream::iter([request]))
        .await
        .unwrap()
        .into_inner();
    let Some(MessageResponse::ListServicesResponse(listed)) =
        answers.message().await.unwrap().unwrap().message_response
    else {
        panic!("no list of services");
    };
    let listed: Vec<String> = listed.service.into_iter().map(|service| service.name).collect();

    assert!(!listed.iter().any(|name| name.contains("WorkerService")), "it is served elsewhere: {listed:?}");
    assert_eq!(listed.len(), SERVICES.len() + 2, "health, reflection and ours: {listed:?}");

    let mut health = HealthClient::new(channel);
    for service in SERVICES {
        assert!(listed.iter().any(|name| name == service), "{service} is not among {listed:?}");
        let status = health.check(HealthCheckRequest { service: service.to_owned() }).await.unwrap().into_inner();
        assert_eq!(status.status(), ServingStatus::Serving, "{service}");
    }
}
