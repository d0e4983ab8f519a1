//! The guard: a layer before every service. It authenticates the caller of each call, and admits or refuses the call by
//! the authorisation table.

use std::{
    convert::Infallible,
    pin::Pin,
    sync::Arc,
    task::{Context, Poll},
};

use bytes::Bytes;
use gleaner_edge::{Call, ConnectionState, refuse};
use tonic::{
    Status,
    body::Body,
    codegen::http::{Request, Response},
};
use tower::{Layer, Service};

use super::{
    audit::{AuditDraft, AuditGuard},
    authenticator::Authenticator,
    caller::Caller,
    refusal_limit::RefusalLimit,
    request_body::RequestBody,
    response_body::ResponseBody,
    secret,
    table::{Need, Rule, rule},
    token_cache::{LiveToken, TokenCache},
    worker::Worker,
};
use crate::{
    connections::{self, Connections, refused},
    domain::client::Client,
    error::{Error, Result},
    jobs::Jobs,
    store::Store,
    wire::status::{from_error, no_such_rpc},
};

/// The result for the transport.
type Answered = std::result::Result<Response<Body>, Infallible>;

/// The layer; clones share it.
#[derive(Clone)]
pub(crate) struct Guard(Arc<GuardMode>);

/// The listener that it guards.
enum GuardMode {
    /// The listener of all clients; workers' calls are rejected.
    Callers(Callers),
    /// The listener of the server's workers; all other calls are rejected.
    Workers(Jobs, Connections),
}

struct Callers {
    authenticator: Authenticator,
    store: Store,
    connections: Connections,
    refusal_limit: RefusalLimit,
}

impl Guard {
    /// The guard of the listener that clients call. `required`: callers without a token are rejected.
    pub(crate) fn new(tokens: TokenCache, store: Store, required: bool, connections: Connections) -> Self {
        let (authenticator, refusal_limit) = (Authenticator::new(tokens, required), RefusalLimit::new());
        Self(Arc::new(GuardMode::Callers(Callers { authenticator, store, connections, refusal_limit })))
    }

    /// The guard of the listener that our own workers call.
    pub(crate) fn of_workers(jobs: Jobs, connections: Connections) -> Self {
        Self(Arc::new(GuardMode::Workers(jobs, connections)))
    }
}

impl<S> Layer<S> for Guard {
    type Service = Guarded<S>;

    fn layer(&self, inner: S) -> Guarded<S> {
        Guarded { inner, guard: self.clone() }
    }
}

/// Services behind the guard.
#[derive(Clone)]
pub(crate) struct Guarded<S> {
    inner: S,
    guard: Guard,
}

impl<S, B> Service<Request<Body>> for Guarded<S>
where
    S: Service<Request<Body>, Response = Response<B>, Error = Infallible> + Clone + Send + 'static,
    S::Future: Send,
    B: http_body::Body<Data = Bytes, Error = Status> + Send + 'static,
{
    type Response = Response<Body>;
    type Error = Infallible;
    type Future = Pin<Box<dyn Future<Output = Answered> + Send>>;

    fn poll_ready(&mut self, cx: &mut Context<'_>) -> Poll<std::result::Result<(), Infallible>> {
        self.inner.poll_ready(cx)
    }

    fn call(&mut self, request: Request<Body>) -> Self::Future {
        // The service that was polled ready serves this call.
        let fresh = self.inner.clone();
        let ready = std::mem::replace(&mut self.inner, fresh);
        Box::pin(self.guard.clone().serve(ready, request))
    }
}

impl Guard {
    async fn serve<S, B>(self, inner: S, mut request: Request<Body>) -> Answered
    where
        S: Service<Request<Body>, Response = Response<B>, Error = Infallible>,
        B: http_body::Body<Data = Bytes, Error = Status> + Send + 'static,
    {
        secret::hide(request.headers_mut());
        match &*self.0 {
            GuardMode::Callers(callers) => callers.serve(inner, request).await,
            GuardMode::Workers(jobs, connections) => serve_worker((jobs, connections), inner, request).await,
        }
    }
}

/// Serves a worker, whose token is checked before its request is read.
async fn serve_worker<S, B>(
    (jobs, connections): (&Jobs, &Connections),
    mut inner: S,
    mut request: Request<Body>,
) -> Answered
where
    S: Service<Request<Body>, Response = Response<B>, Error = Infallible>,
    B: http_body::Body<Data = Bytes, Error = Status> + Send + 'static,
{
    match rule(request.uri().path()) {
        Some(Rule { need: Need::Job, .. }) => {}
        Some(_) | None => return Ok(no_such_rpc().into_http()),
    }
    // Counted for the address before the disk is read. Calls of an attempt have the pace of its job, and no other limit.
    let counted = count_for_address(connections, &request);
    // A worker calls one address, which may move with the lead before this server has it: it waits for that.
    let led = || jobs.expect_leader().map_err(|error| Error::unavailable(error.message()));
    let worker = match counted.and_then(|counted| led().map(|()| counted)) {
        Ok(_counted) => Worker::authenticate(jobs, request.headers()).await,
        Err(error) => Err(error),
    };
    match worker {
        Ok(worker) => {
            request.extensions_mut().insert(worker);
            Ok(inner.call(request).await?.map(Body::new))
        }
        Err(error) => {
            drop(request);
            Ok(refuse(from_error(error)).await)
        }
    }
}

impl Callers {
    async fn serve<S, B>(&self, mut inner: S, mut request: Request<Body>) -> Answered
    where
        S: Service<Request<Body>, Response = Response<B>, Error = Infallible>,
        B: http_body::Body<Data = Bytes, Error = Status> + Send + 'static,
    {
        // Counted before the disk is read: a flood, of unknown tokens too, costs no more than its responses.
        let hash = secret::bearer_hash(request.headers());
        let known = hash.as_ref().ok().and_then(Option::as_ref).and_then(|hash| self.authenticator.known(hash));
        match self.count(&request, known.as_deref()) {
            Ok(None) => {}
            Ok(Some(call)) => {
                request.extensions_mut().insert(call);
            }
            Err(error) => {
                drop(request);
                return Ok(refuse(from_error(error)).await);
            }
        }
        let path = request.uri().path().to_owned();
        let rule = match rule(&path) {
            Some(Rule { need: Need::Nothing, .. }) => {
                return Ok(inner.call(request.map(RequestBody::open)).await?.map(Body::new));
            }
            // Workers have a listener of their own.
            Some(Rule { need: Need::Job, .. }) | None => return Ok(no_such_rpc().into_http()),
            Some(rule) => rule,
        };
        let caller = match self.authenticate(hash, known).await {
            Ok(caller) => caller,
            Err(error) => return Ok(from_error(error).into_http()),
        };
        let begin = || AuditGuard(AuditDraft::begin(self.store.clone(), caller.clone(), peer(&request), &path));
        if let Err(error) = caller.permit(rule.need) {
            let audit = (rule.audited && self.refusal_limit.records(&caller)).then(begin);
            return Ok(ResponseBody::wrap(from_error(error).into_http(), &caller, audit).await);
        }
        if rule.leads
            && let Err(error) = self.store.expect_leader()
        {
            let audit = rule.audited.then(begin);
            return Ok(ResponseBody::wrap(from_error(error).into_http(), &caller, audit).await);
        }
        let audit = rule.audited.then(begin);
        if let Some(AuditGuard(draft)) = &audit {
            request.extensions_mut().insert(draft.clone());
        }
        request.extensions_mut().insert(caller.clone());
        let response = inner.call(request.map(|body| RequestBody::by(&caller, body))).await?.map(Body::new);
        Ok(ResponseBody::wrap(response, &caller, audit).await)
    }

    /// Counts a call for its token, or for its address if the token is not in the cache.
    ///
    /// # Errors
    /// Exhausted, with the time to wait before a retry.
    fn count(&self, request: &Request<Body>, known: Option<&LiveToken>) -> Result<Option<Call>> {
        match known {
            Some(live) => self.connections.count(Client::token(&live.token.id)).map(Some).map_err(refused),
            None => count_for_address(&self.connections, request),
        }
    }

    async fn authenticate(&self, hash: Result<Option<String>>, known: Option<Arc<LiveToken>>) -> Result<Caller> {
        self.authenticator.authenticate(hash?.as_deref(), known).await
    }
}

/// Counts a call for its address, if its connection has one: those of unit tests have none.
///
/// # Errors
/// Exhausted, with the time to wait before a retry.
fn count_for_address(connections: &Connections, request: &Request<Body>) -> Result<Option<Call>> {
    let client = request.extensions().get::<ConnectionState>().map(connections::client);
    client.map(|client| connections.count(client)).transpose().map_err(refused)
}

fn peer(request: &Request<Body>) -> String {
    request.extensions().get::<ConnectionState>().map(|connection| connection.peer().to_string()).unwrap_or_default()
}

#[cfg(test)]
mod tests;
