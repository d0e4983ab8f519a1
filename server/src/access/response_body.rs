//! The body of a response. It ends when the caller's token ends, and before its last frame is sent, the audit entry of the
//! call is on disk.

use std::{
    pin::Pin,
    task::{Context, Poll, ready},
};

use bytes::Bytes;
use http_body::Frame;
use tonic::{
    Code, Status,
    body::Body,
    codegen::http::{HeaderMap, Response},
};

use super::{audit::AuditGuard, authenticator::unknown_token, caller::Caller, token_cache::TokenEnd};
use crate::wire::status::trailers;

type Writing = Pin<Box<dyn Future<Output = ()> + Send>>;
type Polled = Poll<Option<Result<Frame<Bytes>, Status>>>;

/// A response's body with its token and its audit entry.
pub(super) struct ResponseBody {
    body: Body,
    /// Completes when the caller's token ends.
    token_end: Option<TokenEnd>,
    audit: Option<AuditGuard>,
    /// The entry while it is written, and the last frame, which is sent afterwards.
    writing: Option<(Writing, Option<Frame<Bytes>>)>,
}

impl ResponseBody {
    /// Wraps a response, if its caller has a token or its call is audited.
    pub(super) async fn wrap(response: Response<Body>, caller: &Caller, audit: Option<AuditGuard>) -> Response<Body> {
        // A response without a body has its status in the headers.
        if let Some(code) = code(response.headers()) {
            if let Some(audit) = audit {
                audit.0.write(code).await;
            }
            return response;
        }
        let token_end = caller.token_end();
        if token_end.is_none() && audit.is_none() {
            return response;
        }
        response.map(|body| Body::new(Self { body, token_end, audit, writing: None }))
    }

    /// Ends the response because its token has ended; returns the last frame.
    fn cut(&mut self) -> Frame<Bytes> {
        self.body = Body::empty();
        Frame::trailers(trailers(unknown_token()))
    }

    /// Begins to write the entry, if there is one; otherwise returns the last frame.
    fn end(&mut self, code: Code, last: Option<Frame<Bytes>>) -> Option<Option<Frame<Bytes>>> {
        self.token_end = None;
        match self.audit.take() {
            Some(audit) => {
                self.writing = Some((Box::pin(audit.0.write(code)), last));
                None
            }
            None => Some(last),
        }
    }
}

impl http_body::Body for ResponseBody {
    type Data = Bytes;
    type Error = Status;

    fn poll_frame(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Polled {
        loop {
            if let Some((writing, last)) = &mut self.writing {
                ready!(writing.as_mut().poll(cx));
                let last = last.take();
                self.writing = None;
                return Poll::Ready(last.map(Ok));
            }
            if self.token_end.as_mut().is_some_and(|end| end.as_mut().poll(cx).is_ready()) {
                let last = self.cut();
                match self.end(Code::Unauthenticated, Some(last)) {
                    Some(last) => return Poll::Ready(last.map(Ok)),
                    None => continue,
                }
            }
            let (code, last) = match ready!(Pin::new(&mut self.body).poll_frame(cx)) {
                Some(Ok(frame)) => match frame.trailers_ref() {
                    Some(trailers) => (code(trailers).unwrap_or(Code::Unknown), Some(frame)),
                    None => return Poll::Ready(Some(Ok(frame))),
                },
                Some(Err(status)) => {
                    // Dropping the guard writes the entry.
                    self.audit = None;
                    return Poll::Ready(Some(Err(status)));
                }
                None => (Code::Unknown, None),
            };
            if let Some(last) = self.end(code, last) {
                return Poll::Ready(last.map(Ok));
            }
        }
    }
}

/// The status of an rpc, if its headers or trailers have it.
fn code(headers: &HeaderMap) -> Option<Code> {
    headers.get(Status::GRPC_STATUS).map(|value| Code::from_bytes(value.as_bytes()))
}
