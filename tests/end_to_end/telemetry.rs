//! What the server tells of itself: metrics, health, request ids, and traces to a collector.

use std::time::Duration;

use gleaner_proto::v1::{session_request::Message as Say, *};
use opentelemetry_proto::tonic::collector::trace::v1::{
    ExportTraceServiceRequest, ExportTraceServiceResponse,
    trace_service_server::{TraceService, TraceServiceServer},
};
use tokio::{
    io::{AsyncReadExt as _, AsyncWriteExt as _},
    net::{TcpListener, TcpStream},
    sync::mpsc,
    time::timeout,
};
use tokio_stream::wrappers::TcpListenerStream;
use tonic::{Code, Request, Response, transport::Server};

use crate::{
    api::Api,
    lab::{self, RECORDINGS},
    live::{self, Robot},
    server::TestServer,
};

const PATIENCE: Duration = Duration::from_secs(120);

/// A page of the server, as it came.
pub async fn get(url: &str) -> String {
    let (address, path) = url.strip_prefix("http://").unwrap().split_once('/').unwrap();
    let mut stream = TcpStream::connect(address).await.unwrap();
    let request = format!("GET /{path} HTTP/1.1\r\nHost: {address}\r\n\r\n");
    stream.write_all(request.as_bytes()).await.unwrap();
    let mut page = String::new();
    timeout(PATIENCE, stream.read_to_string(&mut page)).await.unwrap().unwrap();
    page
}

/// A metric's value, or none.
fn value(page: &str, metric: &str) -> Option<f64> {
    page.lines().find_map(|line| line.strip_prefix(metric)?.trim().parse().ok())
}

#[tokio::test]
async fn metrics_count_what_happens() {
    let server = TestServer::start_with(&["--web-listen", "127.0.0.1:0"]).await;
    let mut api = Api::connect(&server).await;
    lab::create_task(&mut api).await;
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

/// A connection carries one page, in HTTP/1: what could stay open for nothing would be in others' way.
#[tokio::test]
async fn a_connection_of_the_pages_ends_with_its_answer() {
    let server = TestServer::start_with(&["--workers", "0", "--web-listen", "127.0.0.1:0"]).await;
    let address = server.pages().strip_prefix("http://").unwrap().to_owned();
    for asked in [
        "GET /healthz HTTP/1.1\r\nHost: localhost\r\nConnection: keep-alive\r\n\r\n",
        "PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",
    ] {
        let mut stream = TcpStream::connect(&address).await.unwrap();
        stream.write_all(asked.as_bytes()).await.unwrap();
        let mut said = Vec::new();
        // It ends without ours being closed, and speaks no frames.
        timeout(PATIENCE, stream.read_to_end(&mut said)).await.unwrap().unwrap();
        assert!(said.is_empty() || said.starts_with(b"HTTP/1.1 "), "{asked:?}: {said:?}");
    }
}

/// Spans by name, as they arrive at a collector.
struct Collector(mpsc::UnboundedSender<String>);

#[tonic::async_trait]
impl TraceService for Collector {
    async fn export(
        &self,
        request: Request<ExportTraceServiceRequest>,
    ) -> tonic::Result<Response<ExportTraceServiceResponse>> {
        let resources = request.into_inner().resource_spans.into_iter();
        for span in resources.flat_map(|resource| resource.scope_spans).flat_map(|scope| scope.spans) {
            // Refused only when the test has ended.
            let _ = self.0.send(span.name);
        }
        Ok(Response::new(ExportTraceServiceResponse::default()))
    }
}

#[tokio::test]
async fn calls_sessions_and_attempts_are_traced_to_a_collector() {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let endpoint = format!("http://{}", listener.local_addr().unwrap());
    let (tell, mut spans) = mpsc::unbounded_channel();
    let collector = Server::builder().add_service(TraceServiceServer::new(Collector(tell)));
    tokio::spawn(collector.serve_with_incoming(TcpListenerStream::new(listener)));

    let flags = ["--otlp-endpoint", &endpoint, "--web-listen", "127.0.0.1:0"];
    let mut server = TestServer::start_with(&flags).await;
    let mut api = Api::connect(&server).await;
    lab::set_up(&mut api).await;
    let encoder = api.succeed(lab::TASK, lab::pretrain(2)).await.result_id;
    let policy = api.succeed(lab::TASK, lab::train(train_spec::Data::ExpertsOf(encoder), 2)).await.result_id;
    let deploy = DeployRequest { name: "traced@test".into(), policy_id: policy, ..DeployRequest::default() };
    api.policies.deploy(deploy).await.unwrap();
    let mut robot = Robot::open(&mut api, "traced@test").await.unwrap();
    robot.act(live::observe(&live::start_sim())).await.unwrap();
    robot.say(Say::Close(SessionClose::default())).await;
    robot.hear().await.unwrap();

    let page = get(&server.metrics()).await;
    assert_eq!(value(&page, "gleaner_session_seconds_count{deployment=\"traced@test\"} "), Some(1.0), "{page}");
    assert!(page.contains("gleaner_session_seconds{deployment=\"traced@test\",quantile=\"0.99\"}"), "{page}");
    assert_eq!(value(&page, "gleaner_policy_batch_size_count "), Some(1.0), "{page}");
    let answered = "gleaner_observations_total{deployment=\"traced@test\",outcome=\"answered\"} ";
    assert_eq!(value(&page, answered), Some(1.0), "{page}");

    // What has not been sent yet is sent at the end.
    assert!(server.stop().await);
    let mut wanted = vec!["rpc", "attempt", "session"];
    while !wanted.is_empty() {
        let span = timeout(PATIENCE, spans.recv()).await.expect("the spans come").unwrap();
        wanted.retain(|name| *name != span);
    }
}
