//! Pings while the server waits for a client, so that the session of a robot without power or network ends, as one by gRPC
//! does. Must not know the content of messages.

use std::{
    io,
    pin::Pin,
    task::{Context, Poll},
    time::Duration,
};

use bytes::Bytes;
use futures::{SinkExt as _, StreamExt as _};
use tokio::{
    io::{AsyncRead, AsyncWrite, ReadBuf},
    time::{Instant, MissedTickBehavior, interval_at},
};
use tokio_tungstenite::{WebSocketStream, tungstenite::Message};

use crate::error::{Error, Result};

/// Parts of the limit. A client is pinged after each part without a byte, so that it has two of them for its reply: 20 s
/// with the default limit, as by openpi's own server.
const PARTS: u32 = 3;

/// A stream whose received bytes are counted.
pub(super) struct Counted<S> {
    io: S,
    received: u64,
}

impl<S> Counted<S> {
    pub(super) fn new(io: S) -> Self {
        Self { io, received: 0 }
    }
}

/// The next message of a client; `None` at the end of its connection.
///
/// # Errors
/// Late when the client sent no byte for the limit; Invalid when its bytes are not a message.
pub(super) async fn next<S>(socket: &mut WebSocketStream<Counted<S>>, limit: Duration) -> Result<Option<Message>>
where
    S: AsyncRead + AsyncWrite + Unpin,
{
    let part = limit / PARTS;
    let mut ticks = interval_at(Instant::now() + part, part);
    // After a pause of this process, replies have a whole part to arrive.
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let (mut received, mut silent) = (socket.get_ref().received, 0);
    loop {
        let replied = tokio::select! {
            // Bytes that have arrived count before the tick that was due meanwhile.
            biased;
            message = socket.next() => match message.transpose().map_err(|error| Error::invalid("message", error))? {
                Some(Message::Ping(_) | Message::Pong(_) | Message::Frame(_)) => {
                    ticks.reset();
                    true
                }
                message => return Ok(message),
            },
            _ = ticks.tick() => false,
        };
        let before = std::mem::replace(&mut received, socket.get_ref().received);
        // A client in the middle of a long message cannot reply.
        if replied || received > before {
            silent = 0;
            continue;
        }
        silent += 1;
        if silent == PARTS {
            return Err(Error::late(format!(
                "the client sent no message and answered no ping for {} s (--keepalive-timeout); connect again",
                limit.as_secs()
            )));
        }
        // A failure is that of the next read.
        let _ = tokio::time::timeout(part, socket.send(Message::Ping(Bytes::new()))).await;
    }
}

impl<S: AsyncRead + Unpin> AsyncRead for Counted<S> {
    fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        let before = buf.filled().len();
        let read = Pin::new(&mut self.io).poll_read(cx, buf);
        self.received += buf.filled().len().saturating_sub(before) as u64;
        read
    }
}

impl<S: AsyncWrite + Unpin> AsyncWrite for Counted<S> {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &[u8]) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.io).poll_write(cx, buf)
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.io).poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.io).poll_shutdown(cx)
    }
}

#[cfg(test)]
mod tests {
    use tokio::io::{AsyncWriteExt as _, DuplexStream, duplex};
    use tokio_tungstenite::tungstenite::protocol::Role;

    use super::*;
    use crate::error::Kind;

    const LIMIT: Duration = Duration::from_secs(30);

    async fn connected() -> (WebSocketStream<Counted<DuplexStream>>, DuplexStream) {
        let (ours, theirs) = duplex(1 << 10);
        (WebSocketStream::from_raw_socket(Counted::new(ours), Role::Server, None).await, theirs)
    }

    #[tokio::test(start_paused = true)]
    async fn client_that_answers_no_ping_is_lost_after_the_limit() {
        let (mut socket, _theirs) = connected().await;
        let begun = Instant::now();
        let error = next(&mut socket, LIMIT).await.unwrap_err();
        assert_eq!((error.kind(), begun.elapsed()), (Kind::Late, LIMIT), "{error}");
        assert!(error.to_string().contains("answered no ping for 30 s (--keepalive-timeout)"), "{error}");
    }

    /// Also once it has answered: the limit begins again with each reply.
    #[tokio::test(start_paused = true)]
    async fn client_that_answers_pings_may_wait_for_hours() {
        let (mut socket, theirs) = connected().await;
        let mut client = WebSocketStream::from_raw_socket(theirs, Role::Client, None).await;
        let waiting = tokio::spawn(async move {
            let pings = tokio::time::timeout(3600 * LIMIT, async {
                while let Some(Ok(Message::Ping(_))) = client.next().await {}
            });
            assert!(pings.await.is_err(), "the server ended the connection");
            client.send(Message::binary("seen")).await.unwrap();
            client
        });
        assert_eq!(next(&mut socket, LIMIT).await.unwrap(), Some(Message::binary("seen")));
        let _client = waiting.await.unwrap();
        let begun = Instant::now();
        assert_eq!(next(&mut socket, LIMIT).await.unwrap_err().kind(), Kind::Late);
        assert_eq!(begun.elapsed(), LIMIT);
    }

    #[tokio::test(start_paused = true)]
    async fn message_that_arrives_slowly_is_received() {
        let (mut socket, mut theirs) = connected().await;
        // A masked binary message of 100 bytes, by a key of zeros.
        let message = [&[0x82, 0x80 | 100, 0, 0, 0, 0][..], &[7; 100]].concat();
        let slow = tokio::spawn(async move {
            for byte in message {
                tokio::time::sleep(LIMIT / 2).await;
                theirs.write_all(&[byte]).await.unwrap();
            }
        });
        assert_eq!(next(&mut socket, LIMIT).await.unwrap(), Some(Message::binary(vec![7; 100])));
        slow.await.unwrap();
    }
}
