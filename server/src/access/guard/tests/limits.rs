//! Who asks too much: what is counted for whom, and what of it the audit log hears.

use futures::future::join_all;

use super::{ending::all, *};

impl Bench {
    /// A bench where a client has one call a second, two in a burst.
    async fn strict() -> Self {
        let connections = connections(&ConnectionsConfig { calls_per_second: 1, ..ConnectionsConfig::default() });
        let connection = Some(ConnectionState::new(([10, 0, 0, 1], 7).into()));
        Self { connections, connection, ..Self::new().await }
    }

    /// How many calls went as they go without a limit, before one was refused by it.
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
async fn who_has_no_good_token_is_counted_for_the_address_and_who_has_one_is_not() {
    let bench = Bench::strict().await;
    bench.token("anna", Role::Viewer, None).await;
    assert!(bench.tokens.find(&secret::hash("anna")).await.unwrap().is_some());
    let path = Rpc::TaskServiceListTasks.path();
    assert!(bench.until_refused(path, Some("unknown"), Code::Unauthenticated).await >= 2);
    // Of all of these, which are the same address, at most one is let through again.
    let calls = [(path, None), ("/no/rpc", None), ("/grpc.health.v1.Health/Check", None), (path, Some("nobody"))];
    let codes = join_all(calls.map(|(path, token)| bench.code(true, path, token))).await;
    assert!(codes.iter().filter(|code| **code == Code::ResourceExhausted).count() >= 3, "{codes:?}");
    assert!(bench.until_refused(path, Some("anna"), Code::Ok).await >= 2, "another client, another count");
}

#[tokio::test]
async fn a_call_too_many_is_refused_before_anything_is_written() {
    let bench = Bench::strict().await;
    bench.token("viewer", Role::Viewer, None).await;
    bench.tokens.find(&secret::hash("viewer")).await.unwrap();
    let path = Rpc::PolicyServiceDeploy.path();
    let counted = bench.until_refused(path, Some("viewer"), Code::PermissionDenied).await;
    assert_eq!(bench.log().await.len(), counted);
}

#[tokio::test]
async fn a_flood_of_refusals_does_not_fill_the_audit_log() {
    let bench = Bench::new().await;
    bench.token("viewer", Role::Viewer, None).await;
    let service = service_fn(|_: Request<Body>| async move { Ok(Response::new(Body::empty())) });
    let mut guarded = bench.guard(true).layer(service);
    for _ in 0..100 {
        let request = bench.request(Rpc::PolicyServiceDeploy.path(), Some("viewer"), Body::empty());
        assert_eq!(end(guarded.call(request).await.unwrap()).await, Code::PermissionDenied);
    }
    let logged = bench.log().await.len();
    assert!((10..50).contains(&logged), "{logged}");
}

#[tokio::test]
async fn what_anybody_may_ask_is_small() {
    let bench = Bench::new().await;
    for (bytes, code) in [(100, Code::Ok), (100 << 10, Code::ResourceExhausted)] {
        let service = service_fn(|request: Request<Body>| async move { Ok(all(request).await) });
        let request = bench.request("/grpc.health.v1.Health/Check", None, Body::new(Says::Bytes(bytes)));
        let answer = bench.guard(true).layer(service).call(request).await.unwrap();
        assert_eq!(end(answer).await, code, "{bytes} bytes");
    }
}
