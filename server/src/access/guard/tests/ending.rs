//! Calls that end early: the caller disconnects, or its token ends.

use futures::poll;

use super::*;

/// No event in these tests takes longer.
const PATIENCE: Duration = Duration::from_secs(30);

impl Fixture {
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
async fn a_disconnected_caller_is_in_the_audit_log() {
    let fixture = Fixture::new().await;
    drop(fixture.call(false, Rpc::PolicyServiceDeploy.path(), None, || TestBody::Pending).await);
    assert_eq!(fixture.outcome().await, "Cancelled");
}

#[tokio::test]
async fn a_change_is_in_the_audit_log_if_its_caller_disconnects_during_the_write() {
    let fixture = Fixture::new().await;
    let writer = fixture.store.hold_writer().await.unwrap();
    let mut body = fixture.call(false, Rpc::PolicyServiceDeploy.path(), None, || TestBody::Ok).await.into_body();
    let mut next = std::future::poll_fn(|cx| Pin::new(&mut body).poll_frame(cx));
    assert!(poll!(&mut next).is_pending(), "the response waits for the entry");
    drop(body);
    drop(writer);
    assert_eq!(fixture.outcome().await, "ok");
}

#[tokio::test]
async fn a_refusal_is_in_the_audit_log_if_its_caller_disconnects_during_the_write() {
    let fixture = Fixture::new().await;
    fixture.token("viewer", Role::Viewer, None).await;
    assert_eq!(fixture.code(true, Rpc::TaskServiceListTasks.path(), Some("viewer")).await, Code::Ok);
    let writer = fixture.store.hold_writer().await.unwrap();
    let mut call = Box::pin(fixture.code(true, Rpc::PolicyServiceDeploy.path(), Some("viewer")));
    assert!(poll!(&mut call).is_pending());
    drop(call);
    drop(writer);
    assert_eq!(fixture.outcome().await, "PermissionDenied");
}

#[tokio::test]
async fn open_calls_of_a_revoked_token_end() {
    let fixture = Fixture::new().await;
    fixture.token("arm", Role::Robot, None).await;
    let session = fixture.call(true, Rpc::PolicyServiceSession.path(), Some("arm"), || TestBody::Pending).await;
    fixture.store.revoke_token("arm").await.unwrap();
    assert_eq!(fixture.ends(end(session)).await, Code::Unauthenticated);
    assert_eq!(fixture.log().await[0].outcome, "Unauthenticated");
}

#[tokio::test]
async fn messages_of_a_revoked_token_are_not_read() {
    let fixture = Fixture::new().await;
    fixture.token("anna", Role::Contributor, None).await;
    assert_eq!(fixture.code(true, Rpc::TaskServiceListTasks.path(), Some("anna")).await, Code::Ok);
    // It responds once the request is complete.
    let upload = service_fn(|request: Request<Body>| async move { Ok(all(request).await) });
    let request = fixture.request(Rpc::EpisodeServiceWriteUpload.path(), Some("anna"), Body::new(TestBody::Pending));
    let mut guarded = fixture.guard(true).layer(upload);
    let answer = guarded.call(request);
    fixture.store.revoke_token("anna").await.unwrap();
    assert_eq!(end(fixture.ends(answer).await.unwrap()).await, Code::Unauthenticated);
}

/// Reads a whole request, and responds with the status of its end.
pub(super) async fn all(mut request: Request<Body>) -> Response<Body> {
    loop {
        match std::future::poll_fn(|cx| Pin::new(request.body_mut()).poll_frame(cx)).await {
            Some(Ok(_)) => {}
            Some(Err(status)) => return status.into_http(),
            None => return Status::ok("").into_http(),
        }
    }
}
