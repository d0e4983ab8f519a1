//! The body of a request. It ends when the caller's token ends, and is limited in size for rpcs that need no token.

use std::{
    pin::Pin,
    task::{Context, Poll},
};

use bytes::Bytes;
use http_body::{Frame, SizeHint};
use tonic::{Status, body::Body};

use super::{authenticator::unknown_token, caller::Caller, token_cache::TokenEnd};
use crate::{error::Error, wire::status::from_error};

/// The most bytes of a request to an rpc that needs no token.
const OPEN_BYTES: usize = 64 << 10;

/// A request's body with its token and its limit.
pub(super) struct RequestBody {
    body: Body,
    /// Completes when the caller's token ends.
    token_end: Option<TokenEnd>,
    /// The bytes that may still be received.
    left: usize,
}

impl RequestBody {
    /// The request to an rpc that needs no token.
    pub(super) fn open(body: Body) -> Body {
        Body::new(Self { body, token_end: None, left: OPEN_BYTES })
    }

    /// The request of an authenticated caller.
    pub(super) fn by(caller: &Caller, body: Body) -> Body {
        match caller.token_end() {
            Some(end) => Body::new(Self { body, token_end: Some(end), left: usize::MAX }),
            None => body,
        }
    }

    /// Ends the body with an error.
    fn end(&mut self, error: Error) -> Poll<Option<Result<Frame<Bytes>, Status>>> {
        self.token_end = None;
        self.body = Body::empty();
        Poll::Ready(Some(Err(from_error(error))))
    }
}

impl http_body::Body for RequestBody {
    type Data = Bytes;
    type Error = Status;

    fn poll_frame(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, Status>>> {
        if self.token_end.as_mut().is_some_and(|end| end.as_mut().poll(cx).is_ready()) {
            return self.end(unknown_token());
        }
        let frame = Pin::new(&mut self.body).poll_frame(cx);
        if let Poll::Ready(Some(Ok(frame))) = &frame
            && let Some(data) = frame.data_ref()
        {
            match self.left.checked_sub(data.len()) {
                Some(left) => self.left = left,
                None => {
                    return self.end(Error::exhausted("request exceeds the 64 KiB limit for unauthenticated calls"));
                }
            }
        }
        frame
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}
