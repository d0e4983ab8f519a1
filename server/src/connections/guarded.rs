//! A connection that ends by itself: when its first call does not come in time, when its peer takes nothing of what it
//! is sent or of an answer, or when all are cut.

use std::{
    io::{self, ErrorKind, IoSlice},
    pin::Pin,
    task::{Context, Poll, ready},
    time::Duration,
};

use tokio::{
    io::{AsyncRead, AsyncWrite, ReadBuf},
    time::{Instant, Sleep, sleep, sleep_until},
};
use tokio_util::sync::{CancellationToken, WaitForCancellationFutureOwned};
use tonic::transport::server::Connected;

use super::{link::Link, places::Place};

/// A connection under watch.
pub(crate) struct Guarded<T> {
    io: T,
    link: Link,
    cut: Pin<Box<WaitForCancellationFutureOwned>>,
    /// Until a call has come.
    first_call: Option<Pin<Box<Sleep>>>,
    stall: Duration,
    /// While the peer takes nothing.
    stalled: Option<Pin<Box<Sleep>>>,
    /// When to look next whether its answers are taken.
    look: Pin<Box<Sleep>>,
    _place: Place,
}

/// What a connection is watched for.
pub(super) struct Terms {
    pub(super) first_call_by: Instant,
    pub(super) stall: Duration,
    pub(super) cut: CancellationToken,
}

impl<T> Guarded<T> {
    pub(super) fn new(io: T, link: Link, place: Place, terms: Terms) -> Self {
        Self {
            io,
            link,
            cut: Box::pin(terms.cut.cancelled_owned()),
            first_call: Some(Box::pin(sleep_until(terms.first_call_by))),
            stall: terms.stall,
            stalled: None,
            look: Box::pin(sleep(terms.stall)),
            _place: place,
        }
    }

    pub(crate) fn link(&self) -> &Link {
        &self.link
    }

    /// An error once the connection is to end.
    fn watch(&mut self, cx: &mut Context<'_>) -> io::Result<()> {
        if self.cut.as_mut().poll(cx).is_ready() {
            return Err(io::Error::new(ErrorKind::ConnectionAborted, "the server has stopped"));
        }
        while self.look.as_mut().poll(cx).is_ready() {
            let now = Instant::now();
            let next = self.link.offers().oldest().unwrap_or(now) + self.stall;
            if next <= now {
                return Err(takes_nothing());
            }
            self.look.as_mut().reset(next);
        }
        let Some(deadline) = &mut self.first_call else { return Ok(()) };
        if self.link.called() {
            self.first_call = None;
        } else if deadline.as_mut().poll(cx).is_ready() {
            metrics::counter!("gleaner_connections_closed_total", "reason" => "no_call").increment(1);
            return Err(io::Error::new(ErrorKind::TimedOut, "no call came in time"));
        }
        Ok(())
    }

    /// Keeps count of how long the peer takes nothing.
    fn taken<R>(&mut self, cx: &mut Context<'_>, outcome: Poll<io::Result<R>>) -> Poll<io::Result<R>> {
        if outcome.is_ready() {
            self.stalled = None;
            return outcome;
        }
        let stall = self.stall;
        let stalled = self.stalled.get_or_insert_with(|| Box::pin(sleep(stall)));
        ready!(stalled.as_mut().poll(cx));
        Poll::Ready(Err(takes_nothing()))
    }
}

fn takes_nothing() -> io::Error {
    metrics::counter!("gleaner_connections_closed_total", "reason" => "stalled").increment(1);
    io::Error::new(ErrorKind::TimedOut, "the peer takes nothing")
}

impl<T: AsyncRead + Unpin> AsyncRead for Guarded<T> {
    fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        self.watch(cx)?;
        let before = buf.filled().len();
        let read = Pin::new(&mut self.io).poll_read(cx, buf);
        self.link.receive(buf.filled().len().saturating_sub(before));
        read
    }
}

impl<T: AsyncWrite + Unpin> AsyncWrite for Guarded<T> {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &[u8]) -> Poll<io::Result<usize>> {
        self.watch(cx)?;
        let written = Pin::new(&mut self.io).poll_write(cx, buf);
        self.taken(cx, written)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bufs: &[IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        self.watch(cx)?;
        let written = Pin::new(&mut self.io).poll_write_vectored(cx, bufs);
        self.taken(cx, written)
    }

    fn is_write_vectored(&self) -> bool {
        self.io.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        self.watch(cx)?;
        let flushed = Pin::new(&mut self.io).poll_flush(cx);
        self.taken(cx, flushed)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        let shut = Pin::new(&mut self.io).poll_shutdown(cx);
        self.taken(cx, shut)
    }
}

impl<T> Connected for Guarded<T> {
    type ConnectInfo = Link;

    fn connect_info(&self) -> Link {
        self.link.clone()
    }
}
