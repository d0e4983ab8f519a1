//! The outermost layer around every call: span, id, duration and status.

use std::{
    pin::Pin,
    task::{Context, Poll},
    time::Instant,
};

use http::{HeaderMap, HeaderValue, Request, Response};
use http_body::{Body, Frame, SizeHint};
use tonic::{Code, Status};
use tower::{Layer, Service};
use tracing::Span;
use ulid::Ulid;

use super::{metrics, request};

/// The name of an rpc of this server by its path.
type Name = fn(&str) -> Option<&'static str>;

/// The label of all other paths, so that callers cannot create labels without end.
const UNKNOWN: &str = "unknown";

/// Wraps the services; see [`RpcService`].
#[derive(Debug, Clone, Copy)]
pub(crate) struct RpcLayer(pub(crate) Name);

impl<S> Layer<S> for RpcLayer {
    type Service = RpcService<S>;

    fn layer(&self, inner: S) -> RpcService<S> {
        RpcService { inner, name: self.0 }
    }
}

/// Gives each call a span and an id, and counts it.
#[derive(Debug, Clone)]
pub(crate) struct RpcService<S> {
    inner: S,
    name: Name,
}

impl<S, I, O> Service<Request<I>> for RpcService<S>
where
    S: Service<Request<I>, Response = Response<O>>,
    S::Future: Send + 'static,
    O: Body,
{
    type Response = Response<TracedBody<O>>;
    type Error = S::Error;
    type Future = Pin<Box<dyn Future<Output = Result<Self::Response, S::Error>> + Send>>;

    fn poll_ready(&mut self, cx: &mut Context<'_>) -> Poll<Result<(), S::Error>> {
        self.inner.poll_ready(cx)
    }

    fn call(&mut self, request: Request<I>) -> Self::Future {
        let path = request.uri().path();
        let call = Call::begin(path, (self.name)(path).unwrap_or(UNKNOWN));
        let response = call.within(|| self.inner.call(request));
        Box::pin(TracedCall { call: Some(call), response: Box::pin(response) })
    }
}

/// One call.
struct Call {
    id: Ulid,
    span: Span,
    method: &'static str,
    begun: Instant,
    /// Its final status, once known.
    code: Option<Code>,
}

impl Call {
    fn begin(path: &str, method: &'static str) -> Self {
        let id = Ulid::generate();
        let span = tracing::info_span!("rpc", rpc.path = path, request.id = %id, rpc.code = tracing::field::Empty);
        Self { id, span, method, begun: Instant::now(), code: None }
    }

    fn within<T>(&self, work: impl FnOnce() -> T) -> T {
        self.span.in_scope(|| request::within(self.id, work))
    }

    /// Reads the final status, and adds the id to the response of a failed call.
    fn ends(&mut self, metadata: &mut HeaderMap) {
        let Some(status) = metadata.get(Status::GRPC_STATUS) else { return };
        let code = Code::from_bytes(status.as_bytes());
        self.code = Some(code);
        if code != Code::Ok
            && let Ok(id) = HeaderValue::from_str(&self.id.to_string())
        {
            metadata.insert(request::HEADER, id);
        }
    }
}

impl Drop for Call {
    fn drop(&mut self) {
        // Dropped without a status: the caller is gone or cancelled the call.
        let code = self.code.unwrap_or(Code::Cancelled);
        self.span.record("rpc.code", metrics::code(code));
        metrics::rpc(self.method, code, self.begun.elapsed());
    }
}

/// The pending response.
struct TracedCall<F> {
    /// Taken by the response's body.
    call: Option<Call>,
    response: Pin<Box<F>>,
}

impl<F, O, E> Future for TracedCall<F>
where
    F: Future<Output = Result<Response<O>, E>>,
{
    type Output = Result<Response<TracedBody<O>>, E>;

    fn poll(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Self::Output> {
        let Self { call, response } = &mut *self;
        let Some(at) = call.as_ref() else { return Poll::Pending };
        let responded = std::task::ready!(at.within(|| response.as_mut().poll(cx)));
        Poll::Ready(responded.map(|mut response| {
            if let Some(call) = call.as_mut() {
                call.ends(response.headers_mut());
            }
            let call = call.take();
            response.map(|body| TracedBody { body, call })
        }))
    }
}

/// The body of a response, polled within the call's span.
pub(crate) struct TracedBody<O> {
    body: O,
    /// `None` once the body has ended.
    call: Option<Call>,
}

impl<O: Body + Unpin> Body for TracedBody<O> {
    type Data = O::Data;
    type Error = O::Error;

    fn poll_frame(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<Result<Frame<O::Data>, O::Error>>> {
        let Self { body, call } = &mut *self;
        let Some(at) = call.as_mut() else { return Pin::new(body).poll_frame(cx) };
        let mut polled = at.within(|| Pin::new(body).poll_frame(cx));
        if let Poll::Ready(Some(Ok(frame))) = &mut polled
            && let Some(trailers) = frame.trailers_mut()
        {
            at.ends(trailers);
        }
        if let Poll::Ready(None) = &polled {
            // The body may be kept after its end.
            *call = None;
        }
        polled
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}
