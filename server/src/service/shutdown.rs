//! Services whose streams would stay open forever: each stream ends when the server stops, after its pending messages.

use std::{
    pin::Pin,
    task::{Context, Poll},
};

use bytes::Bytes;
use futures::{FutureExt as _, future::BoxFuture};
use http::{Request, Response};
use http_body::Frame;
use tokio_util::sync::{CancellationToken, WaitForCancellationFutureOwned};
use tonic::{Status, body::Body, server::NamedService};
use tower::Service;

use crate::{error::Error, wire::status::trailers};

/// A service whose streams end when the server stops.
#[derive(Clone)]
pub(super) struct EndAtShutdown<S> {
    service: S,
    stopping: CancellationToken,
}

impl<S> EndAtShutdown<S> {
    pub(super) fn new(service: S, stopping: CancellationToken) -> Self {
        Self { service, stopping }
    }
}

impl<S: NamedService> NamedService for EndAtShutdown<S> {
    const NAME: &'static str = S::NAME;
}

impl<S> Service<Request<Body>> for EndAtShutdown<S>
where
    S: Service<Request<Body>, Response = Response<Body>>,
    S::Future: Send + 'static,
    S::Error: 'static,
{
    type Response = Response<Body>;
    type Error = S::Error;
    type Future = BoxFuture<'static, Result<Response<Body>, S::Error>>;

    fn poll_ready(&mut self, cx: &mut Context<'_>) -> Poll<Result<(), S::Error>> {
        self.service.poll_ready(cx)
    }

    fn call(&mut self, request: Request<Body>) -> Self::Future {
        let stopping = self.stopping.clone();
        // In both directions: a stream is open until both have ended.
        let response = self.service.call(request.map(|body| StreamBody::wrap(stopping.clone(), body)));
        async move { Ok(response.await?.map(|body| StreamBody::wrap(stopping, body))) }.boxed()
    }
}

/// A body that ends when the server stops.
struct StreamBody {
    body: Body,
    /// `None` once the server has stopped.
    stopping: Option<Pin<Box<WaitForCancellationFutureOwned>>>,
}

impl StreamBody {
    fn wrap(stopping: CancellationToken, body: Body) -> Body {
        Body::new(Self { body, stopping: Some(Box::pin(stopping.cancelled_owned())) })
    }
}

impl http_body::Body for StreamBody {
    type Data = Bytes;
    type Error = Status;

    fn poll_frame(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, Status>>> {
        let frame = Pin::new(&mut self.body).poll_frame(cx);
        // Pending messages come first.
        if frame.is_pending()
            && let Some(stopping) = &mut self.stopping
            && stopping.as_mut().poll(cx).is_ready()
        {
            self.stopping = None;
            self.body = Body::empty();
            return Poll::Ready(Some(Ok(Frame::trailers(trailers(Error::unavailable("the server stops"))))));
        }
        frame
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }
}
