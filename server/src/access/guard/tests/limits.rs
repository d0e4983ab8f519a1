//! Limits on calls: the client that a call counts for, and the refusals in the audit log.

use futures::future::join_all;

use super::{ending::all, *};

impl Fixture {
    /// Allows a client one call a second, two in a burst.
    async fn strict() -> Self {
        let connections = connections(&ConnectionsConfig { calls_per_second: 1, ..ConnectionsConfig::default() });
        let connection = Some(ConnectionState::new(([10, 0, 0, 1], 7).into()));
        Self { connections, connection, ..Self::new().await }
    }

    /// The number of calls with the usual status before one is refused by a limit.
    async fn until_refused(&self, path: &str, token: Option<&str>, usual: Code) -> usize {
        for call in 0.. {
            let code = self.code(true, path, token).await;
            if code == Code::ResourceExhausted {
                return call;
            }
            assert_eq!(code, usual, "{path} {token:?}");
        }
        0
    }
}

#[tokio::test]
async fn calls_without_a_valid_token_count_for_the_address_and_others_for_the_token() {
    let fixture = Fixture::strict().await;
    fixture.token("anna", Role::Viewer, None).await;
    assert!(fixture.tokens.find(&secret::hash("anna")).await.unwrap().is_some());
    let path = Rpc::TaskServiceListTasks.path();
    assert!(fixture.until_refused(path, Some("unknown"), Code::Unauthenticated).await >= 2);
    // All of these have the same address; at most one is admitted.
    let calls = [(path, None), ("/no/rpc", None), ("/grpc.health.v1.Health/Check", None), (path, Some("unknown"))];
    let codes = join_all(calls.map(|(path, token)| fixture.code(true, path, token))).await;
    assert!(codes.iter().filter(|code| **code == Code::ResourceExhausted).count() >= 3, "{codes:?}");
    assert!(fixture.until_refused(path, Some("anna"), Code::Ok).await >= 2, "a separate client");
}

#[tokio::test]
async fn a_call_over_the_limit_is_refused_before_an_entry_is_written() {
    let fixture = Fixture::strict().await;
    fixture.token("viewer", Role::Viewer, None).await;
    fixture.tokens.find(&secret::hash("viewer")).await.unwrap();
    let path = Rpc::PolicyServiceDeploy.path();
    let counted = fixture.until_refused(path, Some("viewer"), Code::PermissionDenied).await;
    assert_eq!(fixture.log().await.len(), counted);
}

#[tokio::test]
async fn a_flood_of_refusals_does_not_fill_the_audit_log() {
    let fixture = Fixture::new().await;
    fixture.token("viewer", Role::Viewer, None).await;
    let service = service_fn(|_: Request<Body>| async move { Ok(Response::new(Body::empty())) });
    let mut guarded = fixture.guard(true).layer(service);
    for _ in 0..100 {
        let request = fixture.request(Rpc::PolicyServiceDeploy.path(), Some("viewer"), Body::empty());
        assert_eq!(end(guarded.call(request).await.unwrap()).await, Code::PermissionDenied);
    }
    let logged = fixture.log().await.len();
    assert!((10..50).contains(&logged), "{logged}");
}

#[tokio::test]
async fn requests_without_a_token_are_small() {
    let fixture = Fixture::new().await;
    for (bytes, code) in [(100, Code::Ok), (100 << 10, Code::ResourceExhausted)] {
        let service = service_fn(|request: Request<Body>| async move { Ok(all(request).await) });
        let request = fixture.request("/grpc.health.v1.Health/Check", None, Body::new(TestBody::Bytes(bytes)));
        let answer = fixture.guard(true).layer(service).call(request).await.unwrap();
        assert_eq!(end(answer).await, code, "{bytes} bytes");
    }
}
