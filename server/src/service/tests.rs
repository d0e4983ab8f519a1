//! The audit entry of every rpc that changes something: each is called once through the guard. An audited rpc without a row
//! fails here.

mod metrics;
mod workers;

use std::{
    collections::HashSet,
    convert::Infallible,
    pin::Pin,
    task::{Context, Poll},
};

use bytes::Bytes;
use clap::Parser as _;
use gleaner_edge::ConnectionState;
use gleaner_proto::{Rpc, v1};
use http::{Request, header::CONTENT_TYPE};
use http_body::{Body as _, Frame};
use prost::Message;
use prost_reflect::{Cardinality, DescriptorPool, DynamicMessage, FieldDescriptor, Kind, MessageDescriptor, Value};
use tempfile::TempDir;
use tonic::body::Body;
use tower::{Layer as _, Service as _};

use super::{Services, serve::routes};
use crate::{
    access::{Guard, Named, Subjects, TokenCache, audited},
    config::{Cli, Command},
    connections::connections,
    domain::{access::AuditEntry, time::Millis},
};

/// An id that no row has.
const ID: &str = "01ARZ3NDEKTSV4RRFFQ69G5FAV";

/// The services of a fresh folder behind the guard, without a socket.
struct Server {
    _dir: TempDir,
    services: Services,
}

impl Server {
    async fn start() -> Self {
        let dir = tempfile::tempdir().unwrap();
        let data = dir.path().to_str().unwrap();
        let cli = Cli::try_parse_from(["gleaner-server", "serve", "--workers", "0", "--data-dir", data]).unwrap();
        let Command::Serve(config) = cli.command else { panic!("not serve") };
        let services = Services::open(*config, ([127, 0, 0, 1], 1).into()).await.unwrap();
        Self { _dir: dir, services }
    }

    /// Calls an rpc with one encoded message, reads its response to the end, and returns its audit entry.
    async fn call(&self, rpc: Rpc, message: &[u8]) -> AuditEntry {
        let store = self.services.store.clone();
        let tokens = TokenCache::open(store.clone()).await.unwrap();
        let guard = Guard::new(tokens, store.clone(), false, connections(&self.services.config.connections));
        let mut service = guard.layer(routes(&self.services).await.unwrap().0.prepare());
        let length = u32::try_from(message.len()).unwrap().to_be_bytes();
        let frame = [&[0], length.as_slice(), message].concat();
        let body = Body::new(Sent(Some(frame.into())));
        let mut request = Request::post(rpc.path()).header(CONTENT_TYPE, "application/grpc").body(body).unwrap();
        request.extensions_mut().insert(ConnectionState::new(([10, 0, 0, 1], 7).into()));
        let mut body = service.call(request).await.unwrap().into_body();
        while std::future::poll_fn(|cx| Pin::new(&mut body).poll_frame(cx)).await.is_some() {}
        let mut entries = store.audit(Millis(0), 1000).await.unwrap();
        let entry = entries.pop().unwrap();
        assert_eq!(format!("/gleaner.v1.{}", entry.rpc), rpc.path());
        entry
    }
}

/// A valid task without cameras.
fn task_spec() -> v1::TaskSpec {
    let source = |field: &str| v1::FieldSource {
        field: field.into(),
        topic: "/state".into(),
        paths: vec!["position".into()],
        names: Vec::new(),
        transform: None,
    };
    let fields = |name: &str| vec![v1::FieldSpec { name: name.into(), size: 1, ..v1::FieldSpec::default() }];
    let mapping =
        v1::Mapping { name: "ros".into(), fields: vec![source("joint"), source("target")], ..Default::default() };
    v1::TaskSpec {
        name: "reach".into(),
        instruction: String::new(),
        openpi: Vec::new(),
        rate_hz: 10.0,
        proprioception: fields("joint"),
        action: fields("target"),
        mappings: vec![mapping],
        ..Default::default()
    }
}

/// A request's body in one piece.
struct Sent(Option<Bytes>);

impl http_body::Body for Sent {
    type Data = Bytes;
    type Error = Infallible;

    fn poll_frame(mut self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, Infallible>>> {
        Poll::Ready(self.0.take().map(|bytes| Ok(Frame::data(bytes))))
    }
}

fn repeated(field: &FieldDescriptor) -> bool {
    field.cardinality() == Cardinality::Repeated
}

/// The paths of the texts of a message, through fields that hold one message each.
fn texts(message: &MessageDescriptor, depth: usize) -> Vec<Vec<FieldDescriptor>> {
    let of = |field: FieldDescriptor| {
        if field.kind() == Kind::String {
            return vec![vec![field]];
        }
        let Some(inner) = field.kind().as_message().filter(|_| depth > 0 && !repeated(&field)).cloned() else {
            return Vec::new();
        };
        texts(&inner, depth - 1).into_iter().map(|rest| [vec![field.clone()], rest].concat()).collect()
    };
    message.fields().flat_map(of).collect()
}

/// A message with one text.
fn sample(message: MessageDescriptor, path: &[FieldDescriptor]) -> DynamicMessage {
    let (field, rest) = path.split_first().unwrap();
    let text = Value::String("x".into());
    let value = match field.kind().as_message() {
        Some(inner) => Value::Message(sample(inner.clone(), rest)),
        None if field.is_list() => Value::List(vec![text]),
        None => text,
    };
    let mut sample = DynamicMessage::new(message);
    sample.set_field(field, value);
    sample
}

/// Checks that the subjects of a message are its fields with the name of a name or an id.
fn names_every_subject<M: Message + Default + Named>(message: &MessageDescriptor) {
    for path in texts(message, 3) {
        let field = path.last().unwrap().name();
        let named = matches!(field, "id" | "name" | "task" | "deployment")
            || ["_id", "_ids"].iter().any(|end| field.ends_with(end));
        let decoded = M::decode(sample(message.clone(), &path).encode_to_vec().as_slice()).unwrap();
        let mut subjects = Subjects::default();
        decoded.name_in("", &mut subjects);
        let full: Vec<&str> = path.iter().map(FieldDescriptor::name).collect();
        let expected = if named { vec![format!("{}=x", full.join("."))] } else { Vec::new() };
        assert_eq!(Vec::from(subjects), expected, "{} {full:?}", message.full_name());
    }
}

/// Checks the subjects of an rpc's messages, calls it, and checks its entry: the outcome and the subjects, in which `*`
/// stands for a new id. A macro, because the type of the messages differs by row.
macro_rules! entries {
    ($server:ident, $pool:ident, $seen:ident, $wrong:ident: $($rpc:ident($request:expr) -> $response:ident, $outcome:literal, $subjects:expr;)*) => {$(
        let (service, method) = Rpc::$rpc.path()[1..].split_once('/').unwrap();
        let service = $pool.get_service_by_name(service).unwrap();
        let method = service.methods().find(|found| found.name() == method).unwrap();
        let request = $request;
        names_every_subject_of(&request, &method.input());
        names_every_subject::<v1::$response>(&method.output());
        let entry = $server.call(Rpc::$rpc, &request.encode_to_vec()).await;
        let subjects: Vec<String> = entry.subjects.iter().map(|subject| without_new_id(subject)).collect();
        let expected = $subjects.map(|subject| subject.to_string()).to_vec();
        if (entry.outcome.as_str(), &subjects) != ($outcome, &expected) {
            $wrong.push(format!("{:?}: {:?} {subjects:?}", Rpc::$rpc, entry.outcome));
        }
        assert_eq!((entry.caller.as_str(), entry.token_id, entry.peer.as_str()), ("anyone", None, "10.0.0.1:7"));
        // Garbage is no message: the entry has the outcome alone.
        let entry = $server.call(Rpc::$rpc, &[0xff; 8]).await;
        assert!(entry.outcome != "ok" && entry.subjects.is_empty(), "{entry:?}");
        assert!($seen.insert(Rpc::$rpc));
    )*};
}

fn names_every_subject_of<M: Message + Default + Named>(_: &M, message: &MessageDescriptor) {
    names_every_subject::<M>(message);
}

fn without_new_id(subject: &str) -> String {
    match subject.len().checked_sub(ID.len()) {
        Some(at) if !subject.ends_with(ID) && ulid::Ulid::from_string(&subject[at..]).is_ok() => {
            format!("{}*", &subject[..at])
        }
        _ => subject.to_owned(),
    }
}

#[tokio::test]
async fn every_rpc_that_changes_something_is_in_the_audit_log_with_its_subjects() {
    let server = Server::start().await;
    let pool = DescriptorPool::decode(gleaner_proto::DESCRIPTORS).unwrap();
    let (mut seen, mut wrong) = (HashSet::new(), Vec::new());
    let (task, episode_ids) = (|| "reach".to_owned(), || vec![format!("ep_{ID}")]);
    let pretrain = || v1::PretrainSpec { rule: Some(v1::RoleRule::default()), ..Default::default() };
    let pipeline = || Some(v1::PipelineSpec { pretrain: Some(pretrain()), ..Default::default() });
    let open = v1::SessionOpen { deployment: "arm".into(), ..Default::default() };
    let score = v1::ScoreSpec { encoder_id: format!("enc_{ID}"), ..Default::default() };
    let (snapshot_id, encoder_id) = (format!("snap_{ID}"), format!("enc_{ID}"));
    let import = v1::ImportScoresOpen { snapshot_id, source: "an oracle".into(), encoder_id };
    let import = v1::import_scores_request::Message::Open(import);
    let (session, submitted) = (v1::session_request::Message::Open(open), v1::job_spec::Spec::Score(score));
    let at = v1::create_schedule_request::Trigger::LabelledEpisodes(5);
    entries! { server, pool, seen, wrong:
        TaskServiceCreateTask(v1::CreateTaskRequest { spec: Some(task_spec()) }) -> CreateTaskResponse,
            "ok", ["spec.name=reach", "task.id=task_*", "task.spec.name=reach"];
        TaskServiceUpdateTask(v1::UpdateTaskRequest { task: "arm".into(), spec: Some(task_spec()) }) -> UpdateTaskResponse,
            "NotFound", ["task=arm", "spec.name=reach"];
        TaskServiceDeleteTask(v1::DeleteTaskRequest { task: "arm".into() }) -> DeleteTaskResponse, "NotFound", ["task=arm"];
        EpisodeServiceStartUpload(v1::StartUploadRequest { task: task(), file_name: "a.mcap".into(), size_bytes: 9, blake3: "0".repeat(64), outcome: 1, ..Default::default() })
            -> StartUploadResponse, "ok", ["task=reach", "upload_id=up_*"];
        EpisodeServiceWriteUpload(v1::WriteUploadRequest { upload_id: format!("up_{ID}"), ..Default::default() })
            -> WriteUploadResponse, "NotFound", [format!("upload_id=up_{ID}")];
        EpisodeServiceFinishUpload(v1::FinishUploadRequest { upload_id: format!("up_{ID}") }) -> FinishUploadResponse,
            "NotFound", [format!("upload_id=up_{ID}")];
        EpisodeServiceLabelEpisodes(v1::LabelEpisodesRequest { episode_ids: episode_ids(), outcome: 1, ..Default::default() })
            -> LabelEpisodesResponse, "NotFound", [format!("episode_ids=ep_{ID}")];
        EpisodeServiceDeleteEpisodes(v1::DeleteEpisodesRequest { episode_ids: episode_ids(), force: true })
            -> DeleteEpisodesResponse, "NotFound", [format!("episode_ids=ep_{ID}")];
        EpisodeServiceUndeleteEpisodes(v1::UndeleteEpisodesRequest { episode_ids: vec!["\u{1b}[2J".into()] })
            -> UndeleteEpisodesResponse, "InvalidArgument", ["episode_ids=\\u{1b}[2J"];
        SnapshotServiceCreateSnapshot(v1::CreateSnapshotRequest { task: task(), rule: None }) -> CreateSnapshotResponse,
            "FailedPrecondition", ["task=reach"];
        JobServiceSubmitJob(v1::SubmitJobRequest { task: task(), spec: Some(v1::JobSpec { spec: Some(submitted) }), ..Default::default() })
            -> SubmitJobResponse, "NotFound", ["task=reach".to_owned(), format!("spec.score.encoder_id=enc_{ID}")];
        JobServiceSubmitPipeline(v1::SubmitPipelineRequest { task: task(), pipeline: pipeline(), ..Default::default() })
            -> SubmitPipelineResponse, "FailedPrecondition", ["task=reach"];
        JobServiceCancelJob(v1::CancelJobRequest { job_id: format!("job_{ID}") }) -> CancelJobResponse,
            "NotFound", [format!("job_id=job_{ID}")];
        ScheduleServiceCreateSchedule(v1::CreateScheduleRequest { task: task(), name: "nightly".into(), trigger: Some(at), engine_options: String::new(), pipeline: pipeline() })
            -> CreateScheduleResponse, "ok",
            ["task=reach", "name=nightly", "schedule.id=sch_*", "schedule.task_id=task_*", "schedule.name=nightly"];
        ScheduleServicePauseSchedule(v1::PauseScheduleRequest { schedule_id: format!("sch_{ID}"), paused: true })
            -> PauseScheduleResponse, "NotFound", [format!("schedule_id=sch_{ID}")];
        ScheduleServiceDeleteSchedule(v1::DeleteScheduleRequest { schedule_id: format!("sch_{ID}") })
            -> DeleteScheduleResponse, "NotFound", [format!("schedule_id=sch_{ID}")];
        ScoreServiceImportScores(v1::ImportScoresRequest { message: Some(import) }) -> ImportScoresResponse,
            "NotFound", [format!("open.snapshot_id=snap_{ID}"), format!("open.encoder_id=enc_{ID}")];
        DatasetServiceCreateDataset(v1::CreateDatasetRequest { score_run_id: format!("run_{ID}"), selection: None })
            -> CreateDatasetResponse, "NotFound", [format!("score_run_id=run_{ID}")];
        PolicyServiceRegisterPolicy(v1::RegisterPolicyRequest { task: "arm".into(), remote: Some(v1::RemotePolicy { protocol: 1, ..Default::default() }) })
            -> RegisterPolicyResponse, "NotFound", ["task=arm"];
        PolicyServiceDeploy(v1::DeployRequest { name: "arm".into(), policy_id: format!("pol_{ID}"), score_run_id: String::new(), ..Default::default() })
            -> DeployResponse, "NotFound", ["name=arm".to_owned(), format!("policy_id=pol_{ID}")];
        PolicyServiceRollBack(v1::RollBackRequest { name: "arm".into() }) -> RollBackResponse, "NotFound", ["name=arm"];
        PolicyServiceDeleteDeployment(v1::DeleteDeploymentRequest { name: "arm".into() }) -> DeleteDeploymentResponse, "NotFound", ["name=arm"];
        PolicyServiceReportEvaluation(v1::ReportEvaluationRequest { policy_id: format!("pol_{ID}"), ..Default::default() })
            -> ReportEvaluationResponse, "InvalidArgument", [format!("policy_id=pol_{ID}")];
        PolicyServiceSession(v1::SessionRequest { message: Some(session) }) -> SessionResponse,
            "NotFound", ["open.deployment=arm"];
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert_eq!(seen, audited().collect::<HashSet<_>>(), "each audited rpc has a row here, and no other rpc");
}
