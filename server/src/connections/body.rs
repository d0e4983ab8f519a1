//! The bodies of calls: requests that must come in at a least rate, and answers that hold their call's place.

use std::{
    pin::Pin,
    task::{Context, Poll, ready},
};

use bytes::Bytes;
use http_body::{Body, Frame, SizeHint};
use tokio::time::{Sleep, sleep_until};
use tonic::Status;

use super::{calls::Call, link::Link, offer::Offer, rate::LeastRate};
use crate::{error::Error, wire::status::from_error};

/// A request that ends with an error when it comes too slowly. What counts is every byte of its connection: frames may
/// be large, and what is on its way within one shows in no body.
pub(super) struct Incoming {
    body: tonic::body::Body,
    link: Link,
    rate: LeastRate,
    /// While a frame is waited for.
    alarm: Option<Pin<Box<Sleep>>>,
}

impl Incoming {
    pub(super) fn new(body: tonic::body::Body, link: Link, rate: LeastRate) -> Self {
        Self { body, link, rate, alarm: None }
    }
}

impl Body for Incoming {
    type Data = Bytes;
    type Error = Status;

    fn poll_frame(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, Status>>> {
        let this = &mut *self;
        let frame = Pin::new(&mut this.body).poll_frame(cx);
        if frame.is_ready() {
            this.rate.rest();
            return frame;
        }
        let deadline = this.rate.wait(this.link.received());
        let alarm = this.alarm.get_or_insert_with(|| Box::pin(sleep_until(deadline)));
        while alarm.as_mut().poll(cx).is_ready() {
            // It was set before the newest bytes had come.
            let deadline = this.rate.wait(this.link.received());
            if deadline <= alarm.deadline() {
                metrics::counter!("gleaner_calls_refused_total", "reason" => "slow").increment(1);
                return Poll::Ready(Some(Err(from_error(Error::late(
                    "the request comes in too slowly (--min-bytes-per-second); send it again, an upload from its \
                     committed size on",
                )))));
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

/// An answer; its call runs until it is dropped. It is handed out in pieces, and its connection sees when one is not
/// taken.
pub(crate) struct Answer<B> {
    body: B,
    /// What was not handed out yet of a frame that is larger than a piece.
    rest: Bytes,
    /// The largest piece.
    piece: usize,
    offer: Option<Offer>,
    _call: Option<Call>,
}

impl<B> Answer<B> {
    pub(super) fn new(body: B, piece: usize, offer: Option<Offer>, call: Option<Call>) -> Self {
        Self { body, rest: Bytes::new(), piece, offer, _call: call }
    }

    /// The next piece of what is left of a frame.
    fn next_piece(&mut self) -> Bytes {
        if self.rest.len() > self.piece {
            return self.rest.split_to(self.piece);
        }
        // A copy: the transport may keep the last piece for long, and must not keep all that came before it.
        Bytes::copy_from_slice(&std::mem::take(&mut self.rest))
    }
}

impl<B: Body<Data = Bytes> + Unpin> Body for Answer<B> {
    type Data = Bytes;
    type Error = B::Error;

    fn poll_frame(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, B::Error>>> {
        let this = &mut *self;
        if let Some(offer) = &this.offer {
            offer.taken();
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
        if let Some(offer) = &this.offer {
            offer.made();
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
