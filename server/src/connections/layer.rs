//! The layer around every call that was let in: it marks the call's connection as used, and watches how its request comes
//! in and how its answer is taken.

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
    calls::{Call, is_question},
    link::Link,
    offer::Offer,
    rate::LeastRate,
};
use crate::{error::Error, wire::status::from_error};

/// Calls whose requests come at the pace of a robot or of a worker's job. Each has a limit on silence of its own.
const AT_THEIR_OWN_PACE: [&str; 3] = [
    "/gleaner.v1.PolicyService/Session",
    "/gleaner.v1.ScoreService/ScoreSteps",
    "/gleaner.v1.WorkerService/CompleteJob",
];

/// How long the answer to a refused call takes: who floods has so many calls under way, and none before is answered.
const REFUSED_AFTER: Duration = Duration::from_millis(250);
/// The smallest of the largest pieces of an answer.
const PIECE: usize = 16 << 10;

/// The answer to a call that was refused because its client makes too many, or proves nothing. It takes a while.
pub(crate) async fn refused(error: Error) -> Response<Body> {
    tokio::time::sleep(REFUSED_AFTER).await;
    from_error(error).into_http()
}

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

/// Serves calls under watch.
#[derive(Clone)]
pub(crate) struct CallsService<S> {
    inner: S,
    connections: Connections,
}

impl<S, B> Service<Request<Body>> for CallsService<S>
where
    S: Service<Request<Body>, Response = Response<B>> + Clone + Send + 'static,
    S::Future: Send + 'static,
    S::Error: Send + 'static,
    B: http_body::Body<Data = bytes::Bytes> + Send + Unpin + 'static,
{
    type Response = Response<Answer<B>>;
    type Error = S::Error;
    type Future = Pin<Box<dyn Future<Output = std::result::Result<Self::Response, S::Error>> + Send>>;

    fn poll_ready(&mut self, cx: &mut Context<'_>) -> Poll<std::result::Result<(), S::Error>> {
        self.inner.poll_ready(cx)
    }

    fn call(&mut self, mut request: Request<Body>) -> Self::Future {
        let call = request.extensions_mut().remove::<Call>();
        let link = request.extensions().get::<Link>().cloned();
        if let Some(link) = &link {
            link.call();
        }
        let piece = self.connections.piece();
        let asks = is_question(request.uri().path());
        let request = self.connections.watched(request);
        // The one that was found ready goes with the call.
        let fresh = self.inner.clone();
        let mut ready = std::mem::replace(&mut self.inner, fresh);
        Box::pin(async move {
            let turn = match &call {
                Some(call) if asks => call.turn().await,
                Some(_) | None => None,
            };
            let answer = ready.call(request).await?;
            drop(turn);
            Ok(answer.map(|body| Answer::new(body, piece, link.map(Offer::new), call)))
        })
    }
}

impl Connections {
    /// An answer's body under watch, whose call runs until it is dropped.
    pub(crate) fn answer<B>(&self, body: B, link: Link, call: Call) -> Answer<B> {
        Answer::new(body, self.piece(), Some(Offer::new(link)), Some(call))
    }

    /// The request under watch, unless it comes at its caller's own pace.
    fn watched(&self, request: Request<Body>) -> Request<Body> {
        let path = request.uri().path();
        let Some(link) = request.extensions().get::<Link>().cloned() else { return request };
        if AT_THEIR_OWN_PACE.contains(&path) {
            return request;
        }
        let rate = LeastRate::new(self.config().slow(), self.config().min_bytes_per_second, link.received());
        request.map(|body| Body::new(Incoming::new(body, link, rate)))
    }

    /// The largest piece of an answer: as much as its peer takes at the least rate before it counts as stalled.
    fn piece(&self) -> usize {
        let bytes = u64::from(self.config().min_bytes_per_second).saturating_mul(self.config().stall().as_secs());
        usize::try_from(bytes).unwrap_or(usize::MAX).max(PIECE)
    }
}
