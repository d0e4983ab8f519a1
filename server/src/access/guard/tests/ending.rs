//! Calls that end before their time: the caller goes away, or its token is over.

use futures::poll;

use super::*;

/// No event in these tests takes longer.
const PATIENCE: Duration = Duration::from_secs(30);

impl Bench {
    /// The outcome of the first entry of the audit log, once there is one.
    async fn outcome(&self) -> String {
        let first = async {
            loop {
                if let Some(entry) = self.log().await.pop() {
                    return entry.outcome;
                }
                tokio::task::yield_now().await;
            }
        };
        tokio::time::timeout(PATIENCE, first).await.unwrap()
    }

    /// Waits for a call to end while the tokens are refreshed.
    async fn ends<T>(&self, call: impl Future<Output = T>) -> T {
        tokio::select! {
            () = self.tokens.refresh() => panic!("the refresh ended"),
            ended = tokio::time::timeout(PATIENCE, call) => ended.unwrap(),
        }
    }
}

#[tokio::test]
async fn a_caller_that_goes_away_is_in_the_audit_log() {
    let bench = Bench::new().await;
    drop(bench.call(false, Rpc::PolicyServiceDeploy.path(), None, || Says::Nothing).await);
    assert_eq!(bench.outcome().await, "Cancelled");
}

#[tokio::test]
async fn what_was_done_is_in_the_audit_log_though_its_caller_goes_while_it_is_written() {
    let bench = Bench::new().await;
    let writer = bench.store.hold_writer().await.unwrap();
    let mut body = bench.call(false, Rpc::PolicyServiceDeploy.path(), None, || Says::Yes).await.into_body();
    let mut next = std::future::poll_fn(|cx| Pin::new(&mut body).poll_frame(cx));
    assert!(poll!(&mut next).is_pending(), "the caller hears nothing before it is written");
    drop(body);
    drop(writer);
    assert_eq!(bench.outcome().await, "ok");
}

#[tokio::test]
async fn a_refusal_is_in_the_audit_log_though_its_caller_goes_while_it_is_written() {
    let bench = Bench::new().await;
    bench.token("viewer", Role::Viewer, None).await;
    assert_eq!(bench.code(true, Rpc::TaskServiceListTasks.path(), Some("viewer")).await, Code::Ok);
    let writer = bench.store.hold_writer().await.unwrap();
    let mut call = Box::pin(bench.code(true, Rpc::PolicyServiceDeploy.path(), Some("viewer")));
    assert!(poll!(&mut call).is_pending());
    drop(call);
    drop(writer);
    assert_eq!(bench.outcome().await, "PermissionDenied");
}

#[tokio::test]
async fn what_a_revoked_token_has_open_ends() {
    let bench = Bench::new().await;
    bench.token("arm", Role::Robot, None).await;
    let session = bench.call(true, Rpc::PolicyServiceSession.path(), Some("arm"), || Says::Nothing).await;
    bench.store.revoke_token("arm").await.unwrap();
    assert_eq!(bench.ends(end(session)).await, Code::Unauthenticated);
    assert_eq!(bench.log().await[0].outcome, "Unauthenticated");
}

#[tokio::test]
async fn what_a_revoked_token_still_sends_is_not_taken() {
    let bench = Bench::new().await;
    bench.token("anna", Role::Contributor, None).await;
    assert_eq!(bench.code(true, Rpc::TaskServiceListTasks.path(), Some("anna")).await, Code::Ok);
    // It answers only when all has come.
    let upload = service_fn(|request: Request<Body>| async move { Ok(all(request).await) });
    let request = bench.request(Rpc::EpisodeServiceWriteUpload.path(), Some("anna"), Body::new(Says::Nothing));
    let mut guarded = bench.guard(true).layer(upload);
    let answer = guarded.call(request);
    bench.store.revoke_token("anna").await.unwrap();
    assert_eq!(end(bench.ends(answer).await.unwrap()).await, Code::Unauthenticated);
}

/// Takes all of a request, and answers how that ended.
pub(super) async fn all(mut request: Request<Body>) -> Response<Body> {
    loop {
        match std::future::poll_fn(|cx| Pin::new(request.body_mut()).poll_frame(cx)).await {
            Some(Ok(_)) => {}
            Some(Err(status)) => return status.into_http(),
            None => return Status::ok("").into_http(),
        }
    }
}
