//! The guard before a service that says yes to everything: who gets through, what the audit log has, and what a revoked
//! token has open.

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

/// What a service answers.
enum Says {
    /// Its trailers, and nothing else.
    Yes,
    /// Nothing, ever.
    Nothing,
    /// So many bytes, and that was it.
    Bytes(usize),
}

impl http_body::Body for Says {
    type Data = Bytes;
    type Error = Status;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        _cx: &mut Context<'_>,
    ) -> Poll<Option<std::result::Result<Frame<Bytes>, Status>>> {
        match *self {
            Says::Nothing => Poll::Pending,
            Says::Bytes(0) => Poll::Ready(None),
            Says::Bytes(left) => {
                let some = left.min(100);
                *self = Says::Bytes(left - some);
                Poll::Ready(Some(Ok(Frame::data(vec![7; some].into()))))
            }
            Says::Yes => {
                *self = Says::Nothing;
                let trailers =
                    HeaderMap::from_iter([(HeaderName::from_static("grpc-status"), HeaderValue::from_static("0"))]);
                Poll::Ready(Some(Ok(Frame::trailers(trailers))))
            }
        }
    }
}

struct Bench {
    _dir: TempDir,
    store: Store,
    tokens: TokenCache,
    connections: Connections,
    /// Whose connection calls come over.
    connection: Option<ConnectionState>,
}

impl Bench {
    async fn new() -> Self {
        let (dir, store) = testing::store().await;
        let tokens = TokenCache::open(store.clone()).await.unwrap();
        let connections = connections(&ConnectionsConfig::default());
        Self { _dir: dir, store, tokens, connections, connection: None }
    }

    /// Makes a token that is the word itself.
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

    /// Calls an rpc with a token; the service says what `says` makes.
    async fn call(&self, required: bool, path: &str, token: Option<&str>, says: fn() -> Says) -> Response<Body> {
        let inner = service_fn(move |_: Request<Body>| async move { Ok(Response::new(Body::new(says()))) });
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

    /// As `call`; the status that the caller gets.
    async fn code(&self, required: bool, path: &str, token: Option<&str>) -> Code {
        end(self.call(required, path, token, || Says::Yes).await).await
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

/// The table once more, by role: what each may call beyond the one before.
const CONTRIBUTOR: [&str; 13] = [
    "CreateTask",
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
const TRAINER: [&str; 11] = [
    "CreateSnapshot",
    "SubmitJob",
    "SubmitPipeline",
    "CancelJob",
    "CreateSchedule",
    "PauseSchedule",
    "DeleteSchedule",
    "CreateDataset",
    "Deploy",
    "RollBack",
    "ReportEvaluation",
];
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
async fn every_rpc_with_every_role() {
    let bench = Bench::new().await;
    for role in Role::ALL {
        bench.token(role.as_str(), role, None).await;
    }
    bench.token("revoked", Role::Admin, None).await;
    bench.store.revoke_token("revoked").await.unwrap();
    bench.token("expired", Role::Admin, Some(Millis(1))).await;
    let standard = super::super::table::STANDARD.map(|(path, _)| path);
    let mut walked = 0;
    let (workers, callers): (Vec<&str>, Vec<&str>) =
        Rpc::ALL.iter().map(|rpc| rpc.path()).chain(standard).partition(|path| path.contains(".WorkerService/"));
    for path in callers {
        for role in Role::ALL {
            let code = bench.code(true, path, Some(role.as_str())).await;
            assert_eq!(code, if may(role, path) { Code::Ok } else { Code::PermissionDenied }, "{path} {role:?}");
            walked += 1;
        }
        let method = path.rsplit('/').next().unwrap();
        let open = OPEN.contains(&method);
        for token in [None, Some("unknown"), Some("revoked"), Some("expired")] {
            let code = bench.code(true, path, token).await;
            assert_eq!(code, if open { Code::Ok } else { Code::Unauthenticated }, "{path} {token:?}");
        }
        assert_eq!(bench.code(false, path, None).await, Code::Ok, "{path}: nobody is asked");
    }
    assert!(walked > 250, "the walk found too little: {walked}");
    assert_eq!(workers.len(), 6);
    // Workers have a door of their own.
    let none = ["/gleaner.v1.TaskService/DropTables", "/x", "/gleaner.v1.TaskService/../ListTasks"];
    for path in workers.into_iter().chain(none) {
        assert_eq!(bench.code(true, path, Some("admin")).await, Code::Unimplemented, "{path}");
    }
    assert_eq!(
        bench.code(false, Rpc::TaskServiceListTasks.path(), Some("unknown")).await,
        Code::Unauthenticated,
        "a token that is shown counts, also where none is asked for"
    );
}

#[tokio::test]
async fn what_was_answered_is_in_the_audit_log_and_nothing_else_is() {
    let bench = Bench::new().await;
    let trainer = bench.token("trainer", Role::Trainer, None).await;
    bench.token("viewer", Role::Viewer, None).await;
    let path = Rpc::PolicyServiceDeploy.path();
    assert_eq!(bench.code(true, path, Some("trainer")).await, Code::Ok);
    let log = bench.log().await;
    assert_eq!((log.len(), log[0].who.as_str(), log[0].outcome.as_str()), (1, "trainer", "ok"));
    assert_eq!((log[0].token_id.as_ref(), log[0].rpc.as_str()), (Some(&trainer), "PolicyService/Deploy"));

    bench.code(true, path, Some("viewer")).await;
    bench.code(true, path, Some("nobody")).await;
    bench.code(true, Rpc::TaskServiceListTasks.path(), Some("viewer")).await;
    bench.code(false, path, None).await;
    let log: Vec<(String, String)> = bench.log().await.into_iter().map(|entry| (entry.who, entry.outcome)).collect();
    let pair = |who: &str, outcome: &str| (who.to_owned(), outcome.to_owned());
    assert_eq!(log, [pair("trainer", "ok"), pair("viewer", "PermissionDenied"), pair("anyone", "ok")]);
}
