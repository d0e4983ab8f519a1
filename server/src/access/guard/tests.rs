//! The guard before a service that accepts every call: the calls it admits, their audit entries, and open calls of a revoked
//! token.

mod ending;
mod limits;

use std::time::Duration;

use gleaner_proto::Rpc;
use http_body::{Body as _, Frame};
use tempfile::TempDir;
use tonic::{
    Code,
    codegen::http::{HeaderMap, HeaderName, HeaderValue, header::AUTHORIZATION},
};
use tower::service_fn;

use super::*;
use crate::{
    config::ConnectionsConfig,
    connections::connections,
    domain::{
        access::{AuditEntry, Role, Token},
        id::TokenId,
        time::Millis,
    },
    store::testing,
};

/// The response of a service.
enum TestBody {
    /// Trailers alone.
    Ok,
    /// No frame, and no end.
    Pending,
    /// This many bytes.
    Bytes(usize),
}

impl http_body::Body for TestBody {
    type Data = Bytes;
    type Error = Status;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        _cx: &mut Context<'_>,
    ) -> Poll<Option<std::result::Result<Frame<Bytes>, Status>>> {
        match *self {
            TestBody::Pending => Poll::Pending,
            TestBody::Bytes(0) => Poll::Ready(None),
            TestBody::Bytes(left) => {
                let some = left.min(100);
                *self = TestBody::Bytes(left - some);
                Poll::Ready(Some(Ok(Frame::data(vec![7; some].into()))))
            }
            TestBody::Ok => {
                *self = TestBody::Pending;
                let trailers =
                    HeaderMap::from_iter([(HeaderName::from_static("grpc-status"), HeaderValue::from_static("0"))]);
                Poll::Ready(Some(Ok(Frame::trailers(trailers))))
            }
        }
    }
}

struct Fixture {
    _dir: TempDir,
    store: Store,
    tokens: TokenCache,
    connections: Connections,
    /// The connection of the calls.
    connection: Option<ConnectionState>,
}

impl Fixture {
    async fn new() -> Self {
        let (dir, store) = testing::store().await;
        let tokens = TokenCache::open(store.clone()).await.unwrap();
        let connections = connections(&ConnectionsConfig::default());
        Self { _dir: dir, store, tokens, connections, connection: None }
    }

    /// Issues a token that is the word.
    async fn token(&self, word: &str, role: Role, expires_at: Option<Millis>) -> TokenId {
        let deployments = if role == Role::Robot { vec!["arm@prod".to_owned()] } else { Vec::new() };
        let token = Token {
            id: TokenId::new(),
            name: word.to_owned(),
            role,
            deployments,
            created_at: Millis::now(),
            expires_at,
            revoked_at: None,
            last_used_at: None,
        };
        self.store.insert_token(&token, &secret::hash(word)).await.unwrap();
        token.id
    }

    /// Calls an rpc with a token; the service responds with `body`.
    async fn call(&self, required: bool, path: &str, token: Option<&str>, body: fn() -> TestBody) -> Response<Body> {
        let inner = service_fn(move |_: Request<Body>| async move { Ok(Response::new(Body::new(body()))) });
        self.guard(required).layer(inner).call(self.request(path, token, Body::empty())).await.unwrap()
    }

    fn guard(&self, required: bool) -> Guard {
        Guard::new(self.tokens.clone(), self.store.clone(), required, self.connections.clone())
    }

    fn request(&self, path: &str, token: Option<&str>, body: Body) -> Request<Body> {
        let mut request = Request::new(body);
        *request.uri_mut() = path.parse().unwrap();
        if let Some(token) = token {
            request.headers_mut().insert(AUTHORIZATION, format!("Bearer {token}").parse().unwrap());
        }
        if let Some(connection) = &self.connection {
            request.extensions_mut().insert(connection.clone());
        }
        request
    }

    /// As `call`; the status that the caller receives.
    async fn code(&self, required: bool, path: &str, token: Option<&str>) -> Code {
        end(self.call(required, path, token, || TestBody::Ok).await).await
    }

    async fn log(&self) -> Vec<AuditEntry> {
        self.store.audit(Millis(0), 1000).await.unwrap()
    }
}

/// The status that a response ends with.
async fn end(response: Response<Body>) -> Code {
    let code = |headers: &HeaderMap| headers.get("grpc-status").map(|value| Code::from_bytes(value.as_bytes()));
    if let Some(code) = code(response.headers()) {
        return code;
    }
    let mut body = response.into_body();
    let frame = std::future::poll_fn(|cx| Pin::new(&mut body).poll_frame(cx)).await.unwrap().unwrap();
    code(frame.trailers_ref().unwrap()).unwrap()
}

/// The table once more, by role: the rpcs of each role beyond the role before.
const CONTRIBUTOR: [&str; 15] = [
    "CreateTask",
    "UpdateTask",
    "DeleteTask",
    "StartUpload",
    "WriteUpload",
    "GetUpload",
    "FinishUpload",
    "LabelEpisodes",
    "ScoreRecording",
    "ScoreSteps",
    "Act",
    "Session",
    "ModelInfer",
    "DeleteEpisodes",
    "UndeleteEpisodes",
];
const TRAINER: [&str; 13] = [
    "CreateSnapshot",
    "ImportScores",
    "SubmitJob",
    "SubmitPipeline",
    "CancelJob",
    "CreateSchedule",
    "PauseSchedule",
    "DeleteSchedule",
    "CreateDataset",
    "Deploy",
    "RollBack",
    "DeleteDeployment",
    "ReportEvaluation",
];
const ADMIN: [&str; 1] = ["RegisterPolicy"];
const ROBOT: [&str; 9] = [
    "GetTask",
    "ListDeployments",
    "Act",
    "Session",
    "ModelReady",
    "ServerMetadata",
    "ModelMetadata",
    "ModelInfer",
    "RepositoryIndex",
];
const OPEN: [&str; 4] = ["ServerLive", "ServerReady", "Check", "Watch"];

fn may(role: Role, path: &str) -> bool {
    let method = path.rsplit('/').next().unwrap();
    if OPEN.contains(&method) {
        return true;
    }
    let rung = match method {
        method if CONTRIBUTOR.contains(&method) => 1,
        method if TRAINER.contains(&method) => 2,
        method if ADMIN.contains(&method) => 3,
        _ => 0,
    };
    match role {
        Role::Viewer => rung == 0,
        Role::Contributor => rung <= 1,
        Role::Trainer => rung <= 2,
        Role::Admin => true,
        Role::Robot => ROBOT.contains(&method),
    }
}

#[tokio::test]
async fn every_rpc_is_permitted_as_its_row_states() {
    let fixture = Fixture::new().await;
    for role in Role::ALL {
        fixture.token(role.as_str(), role, None).await;
    }
    fixture.token("revoked", Role::Admin, None).await;
    fixture.store.revoke_token("revoked").await.unwrap();
    fixture.token("expired", Role::Admin, Some(Millis(1))).await;
    let standard = super::super::table::STANDARD.map(|(path, _)| path);
    let mut walked = 0;
    let (workers, callers): (Vec<&str>, Vec<&str>) =
        Rpc::ALL.iter().map(|rpc| rpc.path()).chain(standard).partition(|path| path.contains(".WorkerService/"));
    for path in callers {
        for role in Role::ALL {
            let code = fixture.code(true, path, Some(role.as_str())).await;
            assert_eq!(code, if may(role, path) { Code::Ok } else { Code::PermissionDenied }, "{path} {role:?}");
            walked += 1;
        }
        let method = path.rsplit('/').next().unwrap();
        let open = OPEN.contains(&method);
        for token in [None, Some("unknown"), Some("revoked"), Some("expired")] {
            let code = fixture.code(true, path, token).await;
            assert_eq!(code, if open { Code::Ok } else { Code::Unauthenticated }, "{path} {token:?}");
        }
        assert_eq!(fixture.code(false, path, None).await, Code::Ok, "{path}: no token is required");
    }
    assert!(walked > 250, "the walk found too little: {walked}");
    assert_eq!(workers.len(), 11);
    // Workers have a separate listener.
    let none = ["/gleaner.v1.TaskService/DropTables", "/x", "/gleaner.v1.TaskService/../ListTasks"];
    for path in workers.into_iter().chain(none) {
        assert_eq!(fixture.code(true, path, Some("admin")).await, Code::Unimplemented, "{path}");
    }
    assert_eq!(
        fixture.code(false, Rpc::TaskServiceListTasks.path(), Some("unknown")).await,
        Code::Unauthenticated,
        "a token counts even on a server that requires none"
    );
}

#[tokio::test]
async fn changes_and_refusals_by_role_are_in_the_audit_log_and_other_calls_are_not() {
    let fixture = Fixture::new().await;
    let trainer = fixture.token("trainer", Role::Trainer, None).await;
    fixture.token("viewer", Role::Viewer, None).await;
    let path = Rpc::PolicyServiceDeploy.path();
    assert_eq!(fixture.code(true, path, Some("trainer")).await, Code::Ok);
    let log = fixture.log().await;
    assert_eq!((log.len(), log[0].caller.as_str(), log[0].outcome.as_str()), (1, "trainer", "ok"));
    assert_eq!((log[0].token_id.as_ref(), log[0].rpc.as_str()), (Some(&trainer), "PolicyService/Deploy"));

    fixture.code(true, path, Some("viewer")).await;
    fixture.code(true, path, Some("unknown")).await;
    fixture.code(true, Rpc::TaskServiceListTasks.path(), Some("viewer")).await;
    fixture.code(false, path, None).await;
    let log: Vec<(String, String)> =
        fixture.log().await.into_iter().map(|entry| (entry.caller, entry.outcome)).collect();
    let pair = |caller: &str, outcome: &str| (caller.to_owned(), outcome.to_owned());
    assert_eq!(log, [pair("trainer", "ok"), pair("viewer", "PermissionDenied"), pair("anyone", "ok")]);
}
