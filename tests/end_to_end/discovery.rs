//! Discovery by generic gRPC clients: health by service, and reflection.

use tonic::transport::Channel;
use tonic_health::pb::{HealthCheckRequest, health_check_response::ServingStatus, health_client::HealthClient};
use tonic_reflection::pb::{v1, v1alpha};

use crate::support::server::TestServer;

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

/// The services that a version of reflection lists. The versions differ in their package only. The descriptor of a service
/// must be available too.
macro_rules! reflected {
    ($version:ident, $channel:expr) => {{
        use $version::{
            ServerReflectionRequest, server_reflection_client::ServerReflectionClient,
            server_reflection_request::MessageRequest, server_reflection_response::MessageResponse,
        };
        let request = |message| ServerReflectionRequest { host: String::new(), message_request: Some(message) };
        let requests = [
            request(MessageRequest::ListServices(String::new())),
            request(MessageRequest::FileContainingSymbol("gleaner.v1.TaskService".to_owned())),
        ];
        let mut client = ServerReflectionClient::new($channel.clone());
        let mut responses = client.server_reflection_info(tokio_stream::iter(requests)).await.unwrap().into_inner();
        let Some(MessageResponse::ListServicesResponse(listed)) =
            responses.message().await.unwrap().unwrap().message_response
        else {
            panic!("no list of services");
        };
        let Some(MessageResponse::FileDescriptorResponse(_)) =
            responses.message().await.unwrap().unwrap().message_response
        else {
            panic!("no descriptor of a service");
        };
        listed.service.into_iter().map(|service| service.name).collect::<Vec<String>>()
    }};
}

#[tokio::test]
async fn every_service_is_healthy_and_reflected() {
    let server = TestServer::start_with(&["--workers", "0"]).await;
    let channel = Channel::from_shared(server.url().to_owned()).unwrap().connect().await.unwrap();

    // Older clients (grpcurl before 1.9, Postman) support v1alpha only.
    for listed in [reflected!(v1, &channel), reflected!(v1alpha, &channel)] {
        assert!(!listed.iter().any(|name| name.contains("WorkerService")), "it has a listener of its own: {listed:?}");
        assert_eq!(listed.len(), SERVICES.len() + 3, "health, two versions of reflection and ours: {listed:?}");
        for service in SERVICES {
            assert!(listed.iter().any(|name| name == service), "{service} is not among {listed:?}");
        }
    }

    let mut health = HealthClient::new(channel);
    for service in SERVICES {
        let status = health.check(HealthCheckRequest { service: service.to_owned() }).await.unwrap().into_inner();
        assert_eq!(status.status(), ServingStatus::Serving, "{service}");
    }
}
