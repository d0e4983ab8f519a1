//! The layer around every accepted call: it marks the call's connection as used, queues unary calls, and watches the
//! rates at which the request arrives and the response is read. Must not depend on the meaning of a call.

use std::{
    pin::Pin,
    sync::Arc,
    task::{Context, Poll},
    time::Duration,
};

use http::{Request, Response};
use tonic::{Status, body::Body};
use tower::{Layer, Service};

use crate::{
    body::{RequestBody, ResponseBody},
    calls::Call,
    rate::MinimumRate,
    rules::Rules,
    state::ConnectionState,
};

/// Delay of a rejection: it bounds the rate of a client that floods, because its earlier calls still run.
const REFUSED_AFTER: Duration = Duration::from_millis(250);

/// The response to a call that is rejected because its client exceeds a limit or has no valid credential. It is delayed
/// on purpose.
pub async fn refuse(status: Status) -> Response<Body> {
    tokio::time::sleep(REFUSED_AFTER).await;
    status.into_http()
}

/// Wraps services in [`CallsService`].
#[derive(Clone)]
pub struct CallsLayer(Arc<Rules>);

impl CallsLayer {
    pub(crate) fn new(rules: Arc<Rules>) -> Self {
        Self(rules)
    }
}

impl<S> Layer<S> for CallsLayer {
    type Service = CallsService<S>;

    fn layer(&self, inner: S) -> CallsService<S> {
        CallsService { inner, rules: Arc::clone(&self.0) }
    }
}

/// Serves watched calls. The [`ConnectionState`] and the [`Call`] are extensions of a request.
#[derive(Clone)]
pub struct CallsService<S> {
    inner: S,
    rules: Arc<Rules>,
}

impl<S, B> Service<Request<Body>> for CallsService<S>
where
    S: Service<Request<Body>, Response = Response<B>> + Clone + Send + 'static,
    S::Future: Send + 'static,
    S::Error: Send + 'static,
    B: http_body::Body<Data = bytes::Bytes> + Send + Unpin + 'static,
{
    type Response = Response<ResponseBody<B>>;
    type Error = S::Error;
    type Future = Pin<Box<dyn Future<Output = Result<Self::Response, S::Error>> + Send>>;

    fn poll_ready(&mut self, cx: &mut Context<'_>) -> Poll<Result<(), S::Error>> {
        self.inner.poll_ready(cx)
    }

    fn call(&mut self, mut request: Request<Body>) -> Self::Future {
        let call = request.extensions_mut().remove::<Call>();
        let connection = request.extensions().get::<ConnectionState>().cloned();
        if let Some(connection) = &connection {
            connection.note_call();
        }
        let rules = &self.rules;
        let piece = rules.piece();
        let unary = (rules.call_rules.is_unary)(request.uri().path());
        let request = rules.watched(request);
        // The instance that was polled ready serves this call.
        let fresh = self.inner.clone();
        let mut ready = std::mem::replace(&mut self.inner, fresh);
        Box::pin(async move {
            let turn = match &call {
                Some(call) if unary => call.turn().await,
                Some(_) | None => None,
            };
            let response = ready.call(request).await?;
            drop(turn);
            let pending = connection.map(|connection| connection.pending().begin());
            Ok(response.map(|body| ResponseBody::new(body, piece, pending, call)))
        })
    }
}

impl Rules {
    /// The request under the minimum rate, unless its sender sets the pace.
    fn watched(&self, request: Request<Body>) -> Request<Body> {
        let Some(connection) = request.extensions().get::<ConnectionState>().cloned() else { return request };
        if (self.call_rules.is_self_paced)(request.uri().path()) {
            return request;
        }
        let rate = MinimumRate::new(self.config.slow, self.config.min_bytes_per_second, connection.received());
        let status = self.call_rules.status;
        request.map(|body| Body::new(RequestBody::new(body, connection, rate, status)))
    }
}
