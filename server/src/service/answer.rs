//! The frame of every rpc: runs it and converts its result for tonic; for a change, also names its subjects in the audit
//! log. Must not depend on any single service.

use futures::{Stream, StreamExt as _, TryStreamExt as _, stream::BoxStream};
use tonic::{Code, Request, Response};

use crate::{
    access::{AuditDraft, Named},
    error::Result,
    wire::status::from_error,
};

/// The result of an rpc's method.
pub(super) type Reply<T> = tonic::Result<Response<T>>;

/// The response of an rpc that sends many messages.
pub(super) type Responses<T> = BoxStream<'static, tonic::Result<T>>;

/// Runs an rpc that changes nothing.
pub(super) async fn answer<T>(rpc: impl Future<Output = Result<T>>) -> Reply<T> {
    rpc.await.map(Response::new).map_err(from_error)
}

/// Runs an rpc that changes something. The audit log has the names and ids of its request and response, and the entry is
/// on disk before the response is sent.
pub(super) async fn change<Q: Named, A: Named>(request: Request<Q>, rpc: impl AsyncFnOnce(Q) -> Result<A>) -> Reply<A> {
    change_by(request, async |audit, request| {
        audit.about(&request);
        rpc(request).await
    })
    .await
}

/// As [`change`], for an rpc that receives its request in parts and names their subjects.
pub(super) async fn change_by<Q, A: Named>(
    request: Request<Q>,
    rpc: impl AsyncFnOnce(AuditDraft, Q) -> Result<A>,
) -> Reply<A> {
    let audit = AuditDraft::of(&request).map_err(from_error)?;
    let reply = answer(rpc(audit.clone(), request.into_inner())).await;
    let code = match &reply {
        Ok(response) => {
            audit.about(response.get_ref());
            Code::Ok
        }
        Err(status) => status.code(),
    };
    audit.write(code).await;
    reply
}

/// The messages of a response, with errors converted for tonic.
pub(super) fn responses<T>(messages: impl Stream<Item = Result<T>> + Send + 'static) -> Responses<T> {
    messages.map_err(from_error).boxed()
}
