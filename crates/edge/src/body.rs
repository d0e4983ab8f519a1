//! The bodies of calls: requests that must keep a minimum rate, and responses that hold their call. Must not depend on
//! their content.

use std::{
    pin::Pin,
    task::{Context, Poll, ready},
};

use bytes::Bytes;
use http_body::{Body, Frame, SizeHint};
use tokio::time::{Sleep, sleep_until};
use tonic::Status;

use crate::{calls::Call, error::EdgeError, pending::PendingResponse, rate::MinimumRate, state::ConnectionState};

/// A request that fails below the minimum rate. Every byte of its connection counts: frames may be large, and a partly
/// received frame is in no body yet.
pub(crate) struct RequestBody {
    body: tonic::body::Body,
    state: ConnectionState,
    rate: MinimumRate,
    /// The status of a request that is too slow.
    status: fn(EdgeError) -> Status,
    /// Set while the reader waits for a frame.
    alarm: Option<Pin<Box<Sleep>>>,
}

impl RequestBody {
    pub(crate) fn new(
        body: tonic::body::Body,
        state: ConnectionState,
        rate: MinimumRate,
        status: fn(EdgeError) -> Status,
    ) -> Self {
        Self { body, state, rate, status, alarm: None }
    }
}

impl Body for RequestBody {
    type Data = Bytes;
    type Error = Status;

    fn poll_frame(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, Status>>> {
        let this = &mut *self;
        let frame = Pin::new(&mut this.body).poll_frame(cx);
        if frame.is_ready() {
            this.rate.rest();
            return frame;
        }
        let deadline = this.rate.wait(this.state.received());
        let alarm = this.alarm.get_or_insert_with(|| Box::pin(sleep_until(deadline)));
        while alarm.as_mut().poll(cx).is_ready() {
            // The alarm was set before the newest bytes arrived.
            let deadline = this.rate.wait(this.state.received());
            if deadline <= alarm.deadline() {
                metrics::counter!("gleaner_calls_refused_total", "reason" => "slow").increment(1);
                return Poll::Ready(Some(Err((this.status)(EdgeError::SlowRequest))));
            }
            alarm.as_mut().reset(deadline);
        }
        Poll::Pending
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

/// A response; its call runs until it is dropped. It is sent in pieces, and its connection ends when a piece stays
/// unread.
pub struct ResponseBody<B> {
    body: B,
    /// The unsent rest of a frame that is larger than a piece.
    rest: Bytes,
    /// The largest piece.
    piece: usize,
    pending: Option<PendingResponse>,
    _call: Option<Call>,
}

impl<B> ResponseBody<B> {
    pub(crate) fn new(body: B, piece: usize, pending: Option<PendingResponse>, call: Option<Call>) -> Self {
        Self { body, rest: Bytes::new(), piece, pending, _call: call }
    }

    /// The next piece of the rest of a frame.
    fn next_piece(&mut self) -> Bytes {
        if self.rest.len() > self.piece {
            return self.rest.split_to(self.piece);
        }
        // A copy, because the transport may hold the last piece for long and must not retain the frame's memory.
        Bytes::copy_from_slice(&std::mem::take(&mut self.rest))
    }
}

impl<B: Body<Data = Bytes> + Unpin> Body for ResponseBody<B> {
    type Data = Bytes;
    type Error = B::Error;

    fn poll_frame(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, B::Error>>> {
        let this = &mut *self;
        if let Some(pending) = &this.pending {
            pending.piece_read();
        }
        let piece = if this.rest.is_empty() {
            let frame = match ready!(Pin::new(&mut this.body).poll_frame(cx)) {
                Some(Ok(frame)) => frame,
                end => return Poll::Ready(end),
            };
            match frame.into_data() {
                Ok(data) if data.len() > this.piece => {
                    this.rest = data;
                    this.next_piece()
                }
                Ok(data) => data,
                Err(trailers) => return Poll::Ready(Some(Ok(trailers))),
            }
        } else {
            this.next_piece()
        };
        if let Some(pending) = &this.pending {
            pending.piece_sent();
        }
        Poll::Ready(Some(Ok(Frame::data(piece))))
    }

    fn is_end_stream(&self) -> bool {
        self.rest.is_empty() && self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        if self.rest.is_empty() { self.body.size_hint() } else { SizeHint::default() }
    }
}
