//! The accept loop: a place for each connection, its handshake within its time, and then the connection under watch.

use std::{
    convert::Infallible,
    io,
    net::SocketAddr,
    pin::Pin,
    sync::atomic::{AtomicU32, AtomicU64, Ordering::Relaxed},
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

use super::{
    Connections,
    guarded::{Guarded, Terms},
    link::Link,
    places::Full,
};

/// Connections that are through their handshake and not yet taken up.
const WAITING: usize = 64;
/// How long nothing is accepted after the system refused, which it does when there are no file descriptors left.
const BREATH: Duration = Duration::from_millis(100);

/// 2³² times the golden ratio's fraction. Its multiples are spread evenly, however many there are.
const GOLDEN: u32 = 2_654_435_769;

/// Connections as they come, each under watch. Dropped, it listens no more.
pub(crate) struct Incoming<T> {
    open: mpsc::Receiver<Guarded<T>>,
    _accepting: AbortOnDropHandle<()>,
}

impl<T> Stream for Incoming<T> {
    type Item = Result<Guarded<T>, Infallible>;

    fn poll_next(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        self.open.poll_recv(cx).map(|connection| connection.map(Ok))
    }
}

/// Takes connections from `listener` through `handshake`, which has as long as the first call has.
pub(crate) fn incoming<T, H, F>(connections: &Connections, listener: TcpListener, handshake: H) -> Incoming<T>
where
    T: Send + 'static,
    H: Fn(TcpStream) -> F + Send + Sync + 'static,
    F: Future<Output = io::Result<T>> + Send + 'static,
{
    let (through, open) = mpsc::channel(WAITING);
    let accepting = accept(connections.clone(), listener, handshake, through);
    Incoming { open, _accepting: AbortOnDropHandle::new(tokio::spawn(accepting)) }
}

async fn accept<T, H, F>(
    connections: Connections,
    listener: TcpListener,
    handshake: H,
    through: mpsc::Sender<Guarded<T>>,
) where
    T: Send + 'static,
    H: Fn(TcpStream) -> F,
    F: Future<Output = io::Result<T>> + Send + 'static,
{
    while !through.is_closed() {
        let (stream, peer) = match listener.accept().await {
            Ok(accepted) => accepted,
            // The peer has gone already.
            Err(error) if error.kind() == io::ErrorKind::ConnectionAborted => continue,
            Err(error) => {
                tracing::error!(%error, "no connection can be accepted; trying again");
                tokio::time::sleep(BREATH).await;
                continue;
            }
        };
        // Thousands that come at once must not keep those who are served waiting.
        tokio::task::yield_now().await;
        let Some((place, terms)) = admit(&connections, &stream, peer) else { continue };
        let (shaking, through) = (handshake(stream), through.clone());
        tokio::spawn(async move {
            match tokio::time::timeout_at(terms.first_call_by, shaking).await {
                Ok(Ok(io)) => {
                    // Refused only when nobody serves any more.
                    let _ = through.send(Guarded::new(io, Link::new(peer), place, terms)).await;
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

/// A place for a new connection and what it is watched for; `None` closes it.
fn admit(connections: &Connections, stream: &TcpStream, peer: SocketAddr) -> Option<(super::places::Place, Terms)> {
    let rules = &connections.0;
    let place = match rules.places.take(peer.ip()) {
        Ok(place) => place,
        Err(full) => {
            refused(peer, full);
            return None;
        }
    };
    // Without it a small answer can wait 40 ms for the peer's acknowledgement.
    if let Err(error) = stream.set_nodelay(true) {
        tracing::debug!(peer.address = %peer, %error, "a connection was gone at once");
        return None;
    }
    let terms = Terms {
        first_call_by: Instant::now() + spread(rules.config.first_call()),
        stall: rules.config.stall(),
        cut: rules.cut.clone(),
    };
    Some((place, terms))
}

/// Between three quarters of a time and all of it, each next one elsewhere: those who came together and say nothing do
/// not go together, which would hold up everybody else.
fn spread(time: Duration) -> Duration {
    static PLACE: AtomicU32 = AtomicU32::new(0);
    let place = PLACE.fetch_add(GOLDEN, Relaxed);
    time - time.mul_f64(f64::from(place) / f64::from(u32::MAX) / 4.0)
}

/// Says that a connection was refused, but not of each one: a flood must not fill the log.
fn refused(peer: SocketAddr, full: Full) {
    static REFUSED: AtomicU64 = AtomicU64::new(0);
    let (reason, flag) = match full {
        Full::All => ("all", "--max-connections"),
        Full::Address => ("address", "--max-connections-per-address"),
    };
    metrics::counter!("gleaner_connections_refused_total", "reason" => reason).increment(1);
    let before = REFUSED.fetch_add(1, Relaxed);
    if before.is_power_of_two() || before == 0 {
        tracing::warn!(peer.address = %peer, limit = flag, refused = before + 1, "too many connections: one was refused");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn those_who_come_together_do_not_go_together() {
        let mut times: Vec<Duration> = (0..1000).map(|_| spread(Duration::from_secs(8))).collect();
        times.sort_unstable();
        assert!(times[0] >= Duration::from_secs(6) && times[999] <= Duration::from_secs(8));
        let apart = times.windows(2).map(|pair| pair[1] - pair[0]).max();
        assert!(apart < Some(Duration::from_millis(8)), "{apart:?}");
    }
}
