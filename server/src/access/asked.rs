//! A request on its way in. It ends with the token it is made with, and one that anybody may make is small.

use std::{
    pin::Pin,
    task::{Context, Poll},
};

use bytes::Bytes;
use http_body::{Frame, SizeHint};
use tonic::{Status, body::Body};

use super::{authenticator::unknown_token, caller::Caller, token_cache::Over};
use crate::{error::Error, wire::status::from_error};

/// Most bytes of a request that nobody is asked a token for.
const ANYBODYS: usize = 64 << 10;

/// A request's body under watch.
pub(super) struct Asked {
    body: Body,
    /// Ends when the caller's token is over.
    over: Option<Over>,
    /// How much more may come.
    left: usize,
}

impl Asked {
    /// One that anybody may make.
    pub(super) fn by_anybody(body: Body) -> Body {
        Body::new(Self { body, over: None, left: ANYBODYS })
    }

    /// One of a caller who was let in.
    pub(super) fn by(caller: &Caller, body: Body) -> Body {
        match caller {
            Caller::Known(held) => Body::new(Self { body, over: Some(held.over()), left: usize::MAX }),
            Caller::Anyone => body,
        }
    }

    /// Nothing more is taken.
    fn end(&mut self, why: Error) -> Poll<Option<Result<Frame<Bytes>, Status>>> {
        self.over = None;
        self.body = Body::empty();
        Poll::Ready(Some(Err(from_error(why))))
    }
}

impl http_body::Body for Asked {
    type Data = Bytes;
    type Error = Status;

    fn poll_frame(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, Status>>> {
        if self.over.as_mut().is_some_and(|over| over.as_mut().poll(cx).is_ready()) {
            return self.end(unknown_token());
        }
        let frame = Pin::new(&mut self.body).poll_frame(cx);
        if let Poll::Ready(Some(Ok(frame))) = &frame
            && let Some(data) = frame.data_ref()
        {
            match self.left.checked_sub(data.len()) {
                Some(left) => self.left = left,
                None => return self.end(Error::exhausted("this request is larger than any of its kind")),
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
