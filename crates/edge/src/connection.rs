//! A connection that ends on its own: when its first call does not come in time, when its peer reads nothing or leaves
//! a response unread for too long, or when all connections are cut. Must not depend on the content that is sent.

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

use crate::{permits::Permit, state::ConnectionState};

/// A watched connection: reads and writes fail once it must end.
pub struct Connection<T> {
    io: T,
    state: ConnectionState,
    cut: Pin<Box<WaitForCancellationFutureOwned>>,
    /// Set until the first call arrives.
    first_call: Option<Pin<Box<Sleep>>>,
    write_timeout: Duration,
    /// Set while the peer reads nothing.
    stalled: Option<Pin<Box<Sleep>>>,
    /// Time of the next check that the peer reads its responses.
    check: Pin<Box<Sleep>>,
    _permit: Permit,
}

/// The limits of one connection.
pub(crate) struct Terms {
    pub(crate) first_call_by: Instant,
    pub(crate) write_timeout: Duration,
    pub(crate) cut: CancellationToken,
}

impl<T> Connection<T> {
    pub(crate) fn new(io: T, state: ConnectionState, permit: Permit, terms: Terms) -> Self {
        Self {
            io,
            state,
            cut: Box::pin(terms.cut.cancelled_owned()),
            first_call: Some(Box::pin(sleep_until(terms.first_call_by))),
            write_timeout: terms.write_timeout,
            stalled: None,
            check: Box::pin(sleep(terms.write_timeout)),
            _permit: permit,
        }
    }

    /// Its state, which is an extension of every call on it.
    pub fn state(&self) -> &ConnectionState {
        &self.state
    }

    /// Fails once the connection must end.
    fn watch(&mut self, cx: &mut Context<'_>) -> io::Result<()> {
        if self.cut.as_mut().poll(cx).is_ready() {
            return Err(io::Error::new(ErrorKind::ConnectionAborted, "the server has stopped"));
        }
        while self.check.as_mut().poll(cx).is_ready() {
            let now = Instant::now();
            let next = self.state.pending().oldest().unwrap_or(now) + self.write_timeout;
            if next <= now {
                return Err(reads_nothing());
            }
            self.check.as_mut().reset(next);
        }
        let Some(deadline) = &mut self.first_call else { return Ok(()) };
        if self.state.called() {
            self.first_call = None;
        } else if deadline.as_mut().poll(cx).is_ready() {
            metrics::counter!("gleaner_connections_closed_total", "reason" => "no_call").increment(1);
            return Err(io::Error::new(ErrorKind::TimedOut, "no call came in time"));
        }
        Ok(())
    }

    /// Fails once the peer has read nothing for the write timeout.
    fn written<R>(&mut self, cx: &mut Context<'_>, outcome: Poll<io::Result<R>>) -> Poll<io::Result<R>> {
        if outcome.is_ready() {
            self.stalled = None;
            return outcome;
        }
        let timeout = self.write_timeout;
        let stalled = self.stalled.get_or_insert_with(|| Box::pin(sleep(timeout)));
        ready!(stalled.as_mut().poll(cx));
        Poll::Ready(Err(reads_nothing()))
    }
}

fn reads_nothing() -> io::Error {
    metrics::counter!("gleaner_connections_closed_total", "reason" => "stalled").increment(1);
    io::Error::new(ErrorKind::TimedOut, "the peer reads nothing")
}

impl<T: AsyncRead + Unpin> AsyncRead for Connection<T> {
    fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        self.watch(cx)?;
        let before = buf.filled().len();
        let read = Pin::new(&mut self.io).poll_read(cx, buf);
        self.state.receive(buf.filled().len().saturating_sub(before));
        read
    }
}

impl<T: AsyncWrite + Unpin> AsyncWrite for Connection<T> {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &[u8]) -> Poll<io::Result<usize>> {
        self.watch(cx)?;
        let written = Pin::new(&mut self.io).poll_write(cx, buf);
        self.written(cx, written)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bufs: &[IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        self.watch(cx)?;
        let written = Pin::new(&mut self.io).poll_write_vectored(cx, bufs);
        self.written(cx, written)
    }

    fn is_write_vectored(&self) -> bool {
        self.io.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        self.watch(cx)?;
        let flushed = Pin::new(&mut self.io).poll_flush(cx);
        self.written(cx, flushed)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        let shut = Pin::new(&mut self.io).poll_shutdown(cx);
        self.written(cx, shut)
    }
}

impl<T> Connected for Connection<T> {
    type ConnectInfo = ConnectionState;

    fn connect_info(&self) -> ConnectionState {
        self.state.clone()
    }
}
