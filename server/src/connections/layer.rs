//! The layer around every call: it marks the call's connection as used, counts the call for its client, and watches how
//! its request comes in.

use std::{
    pin::Pin,
    task::{Context, Poll},
    time::Duration,
};

use http::{Request, Response};
use tonic::body::Body;
use tower::{Layer, Service};

use super::{
    Connections,
    body::{Answer, Incoming},
    calls::{Call, Client},
    link::Link,
    places::household,
    rate::LeastRate,
};
use crate::{error::Result, wire::status::from_error};

/// Calls whose requests come at the pace of a robot or of a worker's job. Each has a limit on silence of its own.
const AT_THEIR_OWN_PACE: [&str; 3] =
    ["/gleaner.v1.PolicyService/Session", "/gleaner.v1.ScoreService/ScoreSteps", "/gleaner.v1.WorkerService/"];
/// What workers call. On this machine they are ours, and must not suffer from others at its address.
const WORKERS: &str = "/gleaner.v1.WorkerService/";

/// How long the answer to a refused call takes: who floods has so many calls under way, and none before is answered.
const REFUSED_AFTER: Duration = Duration::from_millis(250);

/// Wraps the services; see [`CallsService`].
#[derive(Clone)]
pub(crate) struct CallsLayer(Connections);

impl CallsLayer {
    pub(super) fn new(connections: Connections) -> Self {
        Self(connections)
    }
}

impl<S> Layer<S> for CallsLayer {
    type Service = CallsService<S>;

    fn layer(&self, inner: S) -> CallsService<S> {
        CallsService { inner, connections: self.0.clone() }
    }
}

/// Serves calls that are within their client's limits and refuses others.
#[derive(Clone)]
pub(crate) struct CallsService<S> {
    inner: S,
    connections: Connections,
}

impl<S, B> Service<Request<Body>> for CallsService<S>
where
    S: Service<Request<Body>, Response = Response<B>>,
    S::Future: Send + 'static,
    S::Error: Send + 'static,
    B: http_body::Body<Data = bytes::Bytes> + Default + Send + Unpin + 'static,
{
    type Response = Response<Answer<B>>;
    type Error = S::Error;
    type Future = Pin<Box<dyn Future<Output = std::result::Result<Self::Response, S::Error>> + Send>>;

    fn poll_ready(&mut self, cx: &mut Context<'_>) -> Poll<std::result::Result<(), S::Error>> {
        self.inner.poll_ready(cx)
    }

    fn call(&mut self, request: Request<Body>) -> Self::Future {
        let call = match self.connections.begin(&request) {
            Ok(call) => call,
            Err(error) => {
                let refused = from_error(error).into_http().map(|body| Answer { body, _call: None });
                return Box::pin(async move {
                    tokio::time::sleep(REFUSED_AFTER).await;
                    Ok(refused)
                });
            }
        };
        let answer = self.inner.call(self.connections.watched(request));
        Box::pin(async move { Ok(answer.await?.map(|body| Answer { body, _call: call })) })
    }
}

impl Connections {
    /// Counts a call, unless it is one of our own workers'.
    fn begin(&self, request: &Request<Body>) -> Result<Option<Call>> {
        let link = request.extensions().get::<Link>();
        if let Some(link) = link {
            link.call();
        }
        let client = match (request.extensions().get::<Client>(), link) {
            (Some(client), _) => client.clone(),
            (None, Some(link)) => {
                if link.peer().ip().is_loopback() && request.uri().path().starts_with(WORKERS) {
                    return Ok(None);
                }
                Client::Address(household(link.peer().ip()))
            }
            // Not over a connection of ours.
            (None, None) => return Ok(None),
        };
        self.0.calls.begin(client).map(Some)
    }

    /// The request under watch, unless it comes at its caller's own pace.
    fn watched(&self, request: Request<Body>) -> Request<Body> {
        let path = request.uri().path();
        let Some(link) = request.extensions().get::<Link>().cloned() else { return request };
        if AT_THEIR_OWN_PACE.iter().any(|own| path.starts_with(own)) {
            return request;
        }
        let rate = LeastRate::new(self.config().slow(), self.config().min_bytes_per_second, link.received());
        request.map(|body| Body::new(Incoming::new(body, link, rate)))
    }
}
