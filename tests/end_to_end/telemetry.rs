//! Telemetry: metrics, health, request ids, and traces to a collector.

use gleaner_proto::v1::*;
use opentelemetry_proto::tonic::collector::trace::v1::{
    ExportTraceServiceRequest, ExportTraceServiceResponse,
    trace_service_server::{TraceService, TraceServiceServer},
};
use tokio::{net::TcpListener, sync::mpsc};
use tokio_stream::wrappers::TcpListenerStream;
use tonic::{Code, Request, Response, transport::Server};

use crate::support::{
    api::Api,
    http::{exchange, get},
    lab::{self, RECORDINGS},
    robot::{Robot, observe, start_sim},
    server::TestServer,
    wait::within,
};

/// The value of a metric, if the page has it.
fn value(page: &str, metric: &str) -> Option<f64> {
    page.lines().find_map(|line| line.strip_prefix(metric)?.trim().parse().ok())
}

#[tokio::test]
async fn metrics_count_calls_and_uploads() {
    let (server, mut api) = lab::with_task(&["--web-listen", "127.0.0.1:0"]).await;
    let recording = &RECORDINGS[0];
    lab::push(&mut api, lab::TASK, recording).await.unwrap();
    let missing = GetEpisodeRequest { episode_id: "ep_01ARZ3NDEKTSV4RRFFQ69G5FAV".into() };
    let error = api.episodes.get_episode(missing).await.unwrap_err();
    assert_eq!((error.code(), error.metadata().get("request-id").unwrap().len()), (Code::NotFound, 26));

    let page = get(&server.metrics()).await;
    assert!(page.starts_with("HTTP/1.1 200 OK"), "{page}");
    assert_eq!(value(&page, "gleaner_upload_bytes_total "), Some(recording.bytes.len() as f64), "{page}");
    let calls = |method: &str, code: &str| {
        value(&page, &format!("gleaner_rpc_seconds_count{{method=\"gleaner.v1.{method}\",code=\"{code}\"}} "))
    };
    assert_eq!(calls("TaskService/CreateTask", "OK"), Some(1.0), "{page}");
    assert_eq!(calls("EpisodeService/GetEpisode", "NOT_FOUND"), Some(1.0), "{page}");
    assert_eq!(value(&page, "gleaner_jobs{state=\"queued\"} "), Some(0.0), "{page}");
    for metric in ["gleaner_connections ", "gleaner_disk_free_bytes ", "gleaner_memory_bytes "] {
        assert!(value(&page, metric).is_some_and(|value| value > 0.0), "{metric}: {page}");
    }
    let health = server.metrics().replace("/metrics", "/healthz");
    assert!(get(&health).await.ends_with("serving\n"));
    assert!(get(&server.metrics().replace("/metrics", "/nothing")).await.starts_with("HTTP/1.1 404"));
}

/// A connection carries one page in HTTP/1, so that idle connections do not use up the limit.
#[tokio::test]
async fn connection_of_the_pages_closes_after_its_response() {
    let server = TestServer::start_with(&["--workers", "0", "--web-listen", "127.0.0.1:0"]).await;
    let address = server.pages().strip_prefix("http://").unwrap().to_owned();
    for request in [
        "GET /healthz HTTP/1.1\r\nHost: localhost\r\nConnection: keep-alive\r\n\r\n",
        "PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",
    ] {
        let response = exchange(&address, request.as_bytes()).await;
        assert!(response.is_empty() || response.starts_with(b"HTTP/1.1 "), "{request:?}: {response:?}");
    }
}

/// A collector that passes on the names of spans.
struct Collector(mpsc::UnboundedSender<String>);

#[tonic::async_trait]
impl TraceService for Collector {
    async fn export(
        &self,
        request: Request<ExportTraceServiceRequest>,
    ) -> tonic::Result<Response<ExportTraceServiceResponse>> {
        let resources = request.into_inner().resource_spans.into_iter();
        for span in resources.flat_map(|resource| resource.scope_spans).flat_map(|scope| scope.spans) {
            // An error means that the test has ended.
            let _ = self.0.send(span.name);
        }
        Ok(Response::new(ExportTraceServiceResponse::default()))
    }
}

#[tokio::test]
async fn calls_sessions_and_attempts_are_traced_to_a_collector() {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let endpoint = format!("http://{}", listener.local_addr().unwrap());
    let (sender, mut spans) = mpsc::unbounded_channel();
    let collector = Server::builder().add_service(TraceServiceServer::new(Collector(sender)));
    tokio::spawn(collector.serve_with_incoming(TcpListenerStream::new(listener)));

    let flags = ["--otlp-endpoint", &endpoint, "--web-listen", "127.0.0.1:0"];
    let mut server = TestServer::start_with(&flags).await;
    let mut api = Api::connect(&server).await;
    lab::set_up(&mut api).await;
    let (_, policy) = api.train_policy(2).await;
    api.deploy("traced@test", &policy).await;
    let mut robot = Robot::open(&mut api, "traced@test").await.unwrap();
    robot.act(observe(&start_sim())).await.unwrap();
    robot.close().await;

    let page = get(&server.metrics()).await;
    assert_eq!(value(&page, "gleaner_session_seconds_count{deployment=\"traced@test\"} "), Some(1.0), "{page}");
    assert!(page.contains("gleaner_session_seconds{deployment=\"traced@test\",quantile=\"0.99\"}"), "{page}");
    assert_eq!(value(&page, "gleaner_policy_batch_size_count "), Some(1.0), "{page}");
    let answered = "gleaner_observations_total{deployment=\"traced@test\",outcome=\"answered\"} ";
    assert_eq!(value(&page, answered), Some(1.0), "{page}");

    // The last spans are sent when the server stops.
    assert!(server.stop().await);
    let mut wanted = vec!["rpc", "attempt", "session"];
    while !wanted.is_empty() {
        let span = within("the spans arrive", spans.recv()).await.unwrap();
        wanted.retain(|name| *name != span);
    }
}
