//! The accept loop: a permit for each connection, its handshake before its deadline, and then the watched connection.
//! Must not depend on the protocol of the handshake.

use std::{
    convert::Infallible,
    io,
    net::SocketAddr,
    pin::Pin,
    sync::{
        Arc,
        atomic::{AtomicU32, AtomicU64, Ordering::Relaxed},
    },
    task::{Context, Poll},
    time::Duration,
};

use futures::Stream;
use tokio::{
    net::{TcpListener, TcpStream},
    sync::mpsc,
    time::Instant,
};
use tokio_util::task::AbortOnDropHandle;

use crate::{
    connection::{Connection, Terms},
    permits::{Full, Permit},
    rules::Rules,
    state::ConnectionState,
};

/// Maximum number of connections whose handshake is done and that are not yet served.
const WAITING: usize = 64;
/// Pause after the system failed to accept, as it does without a free file descriptor.
const BREATH: Duration = Duration::from_millis(100);

/// 2³² times the golden ratio's fraction. Its multiples are spread evenly, however many there are.
const GOLDEN: u32 = 2_654_435_769;

/// The accepted connections, each watched. Dropping it closes the listener.
pub struct Incoming<T> {
    open: mpsc::Receiver<Connection<T>>,
    _accepting: AbortOnDropHandle<()>,
}

impl<T> Stream for Incoming<T> {
    type Item = Result<Connection<T>, Infallible>;

    fn poll_next(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        self.open.poll_recv(cx).map(|connection| connection.map(Ok))
    }
}

/// Accepts connections from `listener` and runs `handshake` on each, before the deadline of its first call.
pub(crate) fn incoming<T, H, F>(rules: &Arc<Rules>, listener: TcpListener, handshake: H) -> Incoming<T>
where
    T: Send + 'static,
    H: Fn(TcpStream) -> F + Send + Sync + 'static,
    F: Future<Output = io::Result<T>> + Send + 'static,
{
    let (through, open) = mpsc::channel(WAITING);
    let accepting = accept(Arc::clone(rules), listener, handshake, through);
    Incoming { open, _accepting: AbortOnDropHandle::new(tokio::spawn(accepting)) }
}

async fn accept<T, H, F>(rules: Arc<Rules>, listener: TcpListener, handshake: H, through: mpsc::Sender<Connection<T>>)
where
    T: Send + 'static,
    H: Fn(TcpStream) -> F,
    F: Future<Output = io::Result<T>> + Send + 'static,
{
    while !through.is_closed() {
        let (stream, peer) = match listener.accept().await {
            Ok(accepted) => accepted,
            // The peer has already closed the connection.
            Err(error) if error.kind() == io::ErrorKind::ConnectionAborted => continue,
            Err(error) => {
                tracing::error!(%error, "no connection can be accepted; trying again");
                tokio::time::sleep(BREATH).await;
                continue;
            }
        };
        // Thousands of simultaneous connections must not delay connections that are served.
        tokio::task::yield_now().await;
        let Some((permit, terms)) = admit(&rules, &stream, peer) else { continue };
        let (shaking, through) = (handshake(stream), through.clone());
        tokio::spawn(async move {
            match tokio::time::timeout_at(terms.first_call_by, shaking).await {
                Ok(Ok(io)) => {
                    // Sending fails only when serving has ended.
                    let _ = through.send(Connection::new(io, ConnectionState::new(peer), permit, terms)).await;
                }
                Ok(Err(error)) => {
                    metrics::counter!("gleaner_connections_closed_total", "reason" => "handshake").increment(1);
                    tracing::debug!(peer.address = %peer, %error, "a handshake failed");
                }
                Err(_) => {
                    metrics::counter!("gleaner_connections_closed_total", "reason" => "no_handshake").increment(1);
                    tracing::debug!(peer.address = %peer, "a handshake took too long");
                }
            }
        });
    }
}

/// A permit for a new connection and its limits; `None` closes it.
fn admit(rules: &Rules, stream: &TcpStream, peer: SocketAddr) -> Option<(Permit, Terms)> {
    let permit = match rules.permits.take(peer.ip()) {
        Ok(permit) => permit,
        Err(full) => {
            refused(peer, full);
            return None;
        }
    };
    // Without this option a small response can wait 40 ms for the peer's acknowledgement.
    if let Err(error) = stream.set_nodelay(true) {
        tracing::debug!(peer.address = %peer, %error, "a connection was gone at once");
        return None;
    }
    let terms = Terms {
        first_call_by: Instant::now() + spread(rules.config.first_call),
        write_timeout: rules.config.write_timeout,
        cut: rules.cut.clone(),
    };
    Some((permit, terms))
}

/// A duration between three quarters of `time` and all of it, different for consecutive connections: silent peers that
/// connected together are not closed together, which would delay every other connection.
fn spread(time: Duration) -> Duration {
    static PLACE: AtomicU32 = AtomicU32::new(0);
    let place = PLACE.fetch_add(GOLDEN, Relaxed);
    time - time.mul_f64(f64::from(place) / f64::from(u32::MAX) / 4.0)
}

/// Logs a rejected connection, at powers of two only, so that a flood cannot fill the log.
fn refused(peer: SocketAddr, full: Full) {
    static REFUSED: AtomicU64 = AtomicU64::new(0);
    let (reason, limit) = match full {
        Full::All => ("all", "max-connections"),
        Full::Address => ("address", "max-connections-per-address"),
    };
    metrics::counter!("gleaner_connections_refused_total", "reason" => reason).increment(1);
    let before = REFUSED.fetch_add(1, Relaxed);
    if before.is_power_of_two() || before == 0 {
        tracing::warn!(peer.address = %peer, limit, refused = before + 1, "too many connections: one was refused");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn deadlines_of_simultaneous_connections_are_spread() {
        let mut times: Vec<Duration> = (0..1000).map(|_| spread(Duration::from_secs(8))).collect();
        times.sort_unstable();
        assert!(times[0] >= Duration::from_secs(6) && times[999] <= Duration::from_secs(8));
        let apart = times.windows(2).map(|pair| pair[1] - pair[0]).max();
        assert!(apart < Some(Duration::from_millis(8)), "{apart:?}");
    }
}
