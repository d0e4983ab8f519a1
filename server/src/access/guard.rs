//! The guard: a layer before every service. It knows who calls, asks the table, and lets the call through or not.

use std::{
    convert::Infallible,
    pin::Pin,
    sync::Arc,
    task::{Context, Poll},
};

use bytes::Bytes;
use tonic::{
    Status,
    body::Body,
    codegen::http::{Request, Response},
};
use tower::{Layer, Service};

use super::{
    answer::Answer,
    book::Book,
    caller::Caller,
    entry::Entry,
    secret,
    table::{Need, rule},
};
use crate::{
    connections::{Client, Link},
    error::{Error, Result},
    store::Store,
    wire::status::{from_error, no_such_rpc},
};

/// Stands before the services; clones share it.
#[derive(Clone)]
pub(crate) struct Guard(Arc<Inner>);

struct Inner {
    book: Book,
    store: Store,
    /// Whether who shows no token is sent away.
    required: bool,
}

impl Guard {
    /// Stands before services.
    pub(crate) fn new(book: Book, store: Store, required: bool) -> Self {
        Self(Arc::new(Inner { book, store, required }))
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
    type Future = Pin<Box<dyn Future<Output = std::result::Result<Response<Body>, Infallible>> + Send>>;

    fn poll_ready(&mut self, cx: &mut Context<'_>) -> Poll<std::result::Result<(), Infallible>> {
        self.inner.poll_ready(cx)
    }

    fn call(&mut self, request: Request<Body>) -> Self::Future {
        // The one that was found ready goes with the call.
        let fresh = self.inner.clone();
        let ready = std::mem::replace(&mut self.inner, fresh);
        Box::pin(self.guard.clone().serve(ready, request))
    }
}

impl Guard {
    async fn serve<S, B>(
        self,
        mut inner: S,
        mut request: Request<Body>,
    ) -> std::result::Result<Response<Body>, Infallible>
    where
        S: Service<Request<Body>, Response = Response<B>, Error = Infallible>,
        B: http_body::Body<Data = Bytes, Error = Status> + Send + 'static,
    {
        secret::hide(request.headers_mut());
        let path = request.uri().path().to_owned();
        let Some(rule) = rule(&path) else { return Ok(no_such_rpc().into_http()) };
        if matches!(rule.need, Need::Nothing | Need::Job) {
            return Ok(inner.call(request).await?.map(Body::new));
        }
        let caller = match self.authenticate(&mut request).await {
            Ok(caller) => caller,
            Err(error) => return Ok(from_error(error).into_http()),
        };
        let entry = rule.audited.then(|| Entry::begin(self.0.store.clone(), caller.clone(), peer(&request), &path));
        if let Err(error) = caller.permit(rule.need) {
            let refused = from_error(error).into_http();
            return Ok(Answer::watched(refused, &caller, entry).await);
        }
        request.extensions_mut().insert(caller.clone());
        let request = match &entry {
            Some(entry) => request.map(|body| entry.overhear(body)),
            None => request,
        };
        let response = inner.call(request).await?.map(Body::new);
        Ok(Answer::watched(response, &caller, entry).await)
    }

    /// Who calls.
    ///
    /// # Errors
    /// Unauthenticated when a token is shown that is none of ours, or none where one is asked for.
    async fn authenticate(&self, request: &mut Request<Body>) -> Result<Caller> {
        let Some(hash) = secret::shown(request.headers())? else {
            return if self.0.required { Err(no_token()) } else { Ok(Caller::Anyone) };
        };
        let held = self.0.book.find(&hash).await?.ok_or_else(unknown_token)?;
        self.0.book.used(&held);
        request.extensions_mut().insert(Client::Token(held.token.id.as_str().into()));
        Ok(Caller::Known(held))
    }
}

fn peer(request: &Request<Body>) -> String {
    request.extensions().get::<Link>().map(|link| link.peer().to_string()).unwrap_or_default()
}

fn no_token() -> Error {
    Error::unauthenticated(
        "this server asks for a token: give one with --token or GLEANER_TOKEN; who runs the server makes one with \
         `gleaner-server token create`",
    )
}

/// What a caller hears whose token is none, or none any more. Which of the two it is, is not said.
pub(super) fn unknown_token() -> Error {
    Error::unauthenticated(
        "this token is not known, has expired or was revoked; who runs the server makes one with \
         `gleaner-server token create`",
    )
}

#[cfg(test)]
mod tests;
