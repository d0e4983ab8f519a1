//! Services whose streams would stay open for ever: they end when the server stops, after what they have still to say.

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

use crate::{error::Error, wire::status::last_words};

/// A service until the server stops.
#[derive(Clone)]
pub(super) struct Until<S> {
    service: S,
    stopping: CancellationToken,
}

impl<S> Until<S> {
    pub(super) fn new(service: S, stopping: CancellationToken) -> Self {
        Self { service, stopping }
    }
}

impl<S: NamedService> NamedService for Until<S> {
    const NAME: &'static str = S::NAME;
}

impl<S> Service<Request<Body>> for Until<S>
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
        // Both ways: a stream is open until both have ended.
        let answer = self.service.call(request.map(|body| Words::until(stopping.clone(), body)));
        async move { Ok(answer.await?.map(|body| Words::until(stopping, body))) }.boxed()
    }
}

/// What is said, until the server stops.
struct Words {
    body: Body,
    /// Until it has stopped.
    stopping: Option<Pin<Box<WaitForCancellationFutureOwned>>>,
}

impl Words {
    fn until(stopping: CancellationToken, body: Body) -> Body {
        Body::new(Self { body, stopping: Some(Box::pin(stopping.cancelled_owned())) })
    }
}

impl http_body::Body for Words {
    type Data = Bytes;
    type Error = Status;

    fn poll_frame(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, Status>>> {
        let frame = Pin::new(&mut self.body).poll_frame(cx);
        // Only once it has nothing more to say.
        if frame.is_pending()
            && let Some(stopping) = &mut self.stopping
            && stopping.as_mut().poll(cx).is_ready()
        {
            self.stopping = None;
            self.body = Body::empty();
            return Poll::Ready(Some(Ok(Frame::trailers(last_words(Error::unavailable("the server stops"))))));
        }
        frame
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }
}
