//! An answer on its way out. It is cut off when the token it was asked with is over, and its end goes to the audit log
//! before the caller hears of it: what was acknowledged is in the log.

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

use super::{authenticator::unknown_token, caller::Caller, entry::Entry, token_cache::Over};
use crate::wire::status::last_words;

type Writing = Pin<Box<dyn Future<Output = ()> + Send>>;
type Polled = Poll<Option<Result<Frame<Bytes>, Status>>>;

/// An answer's body under watch.
pub(super) struct Answer {
    body: Body,
    /// Ends when the caller's token is over.
    over: Option<Over>,
    entry: Option<Entry>,
    /// The entry while it is written, and what the caller hears afterwards.
    writing: Option<(Writing, Option<Frame<Bytes>>)>,
}

impl Answer {
    /// Puts an answer under watch, if there is anything to watch for.
    pub(super) async fn watched(response: Response<Body>, caller: &Caller, entry: Option<Entry>) -> Response<Body> {
        // One that is an error from the beginning has its end in its headers.
        if let Some(code) = code(response.headers()) {
            if let Some(entry) = entry {
                entry.write(code).await;
            }
            return response;
        }
        let over = caller.over();
        if over.is_none() && entry.is_none() {
            return response;
        }
        response.map(|body| Body::new(Self { body, over, entry, writing: None }))
    }

    /// The token is over: says so, and drops what is left.
    fn cut(&mut self) -> Frame<Bytes> {
        self.over = None;
        self.body = Body::empty();
        Frame::trailers(last_words(unknown_token()))
    }

    /// Begins to write how it ended.
    fn end(&mut self, code: Code, last: Option<Frame<Bytes>>) -> Option<Option<Frame<Bytes>>> {
        self.over = None;
        match self.entry.take() {
            Some(entry) => {
                self.writing = Some((Box::pin(entry.write(code)), last));
                None
            }
            None => Some(last),
        }
    }
}

impl http_body::Body for Answer {
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
            if self.over.as_mut().is_some_and(|over| over.as_mut().poll(cx).is_ready()) {
                let last = self.cut();
                match self.end(Code::Unauthenticated, Some(last)) {
                    Some(last) => return Poll::Ready(last.map(Ok)),
                    None => continue,
                }
            }
            let (code, last) = match ready!(Pin::new(&mut self.body).poll_frame(cx)) {
                Some(Ok(frame)) => match frame.trailers_ref() {
                    Some(trailers) => (code(trailers).unwrap_or(Code::Unknown), Some(frame)),
                    None => {
                        if let (Some(entry), Some(data)) = (&mut self.entry, frame.data_ref()) {
                            entry.hear(data);
                        }
                        return Poll::Ready(Some(Ok(frame)));
                    }
                },
                Some(Err(status)) => {
                    // The entry is written as it is dropped.
                    self.entry = None;
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

/// The status of an rpc, where its headers or trailers tell it.
fn code(headers: &HeaderMap) -> Option<Code> {
    headers.get("grpc-status").map(|value| Code::from_bytes(value.as_bytes()))
}
