//! The pieces of a recording that is joined from its parts while it is sent. The join is made again from its beginning for
//! each stream, and the bytes before the first piece are dropped.

use std::io::{Error, ErrorKind, Write};
use std::path::PathBuf;
use std::sync::Arc;

use bytes::{Bytes, BytesMut};
use futures::Stream;
use gleaner_recording::join;
use tokio::sync::mpsc;
use tokio_stream::StreamExt as _;
use tokio_stream::wrappers::ReceiverStream;

use super::{PIECE, Pieces};

/// Pieces that wait for the connection.
const WAITING: usize = 2;

/// The pieces of the join, each with its offset.
pub(super) fn pieces(
    Pieces { offset, end, progress, failure }: Pieces,
    parts: Arc<[PathBuf]>,
) -> impl Stream<Item = (u64, Bytes)> + Send {
    let (send, pieces) = mpsc::channel(WAITING);
    tokio::task::spawn_blocking(move || {
        let mut out = Out { at: 0, next: offset, end, piece: BytesMut::new(), send };
        let joined = join(&parts, &mut out);
        // A connection that has ended has an error of its own.
        if !out.send.is_closed()
            && let Err(error) = joined.map_err(Error::other).and_then(|_| out.send())
        {
            failure.set(error);
        }
    });
    ReceiverStream::new(pieces).map(move |(offset, data): (u64, Bytes)| {
        progress(offset + data.len() as u64);
        (offset, data)
    })
}

/// Takes the bytes of the join and sends them in pieces.
struct Out {
    /// Bytes of the join so far.
    at: u64,
    /// The offset of the next piece.
    next: u64,
    /// The declared size.
    end: u64,
    piece: BytesMut,
    send: mpsc::Sender<(u64, Bytes)>,
}

impl Out {
    fn send(&mut self) -> std::io::Result<()> {
        if self.piece.is_empty() {
            return Ok(());
        }
        let data = self.piece.split().freeze();
        let offset = self.next;
        self.next += data.len() as u64;
        self.send.blocking_send((offset, data)).map_err(|_| ErrorKind::BrokenPipe.into())
    }
}

impl Write for Out {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        let skipped = usize::try_from(self.next.saturating_sub(self.at)).unwrap_or(usize::MAX).min(bytes.len());
        let skipped = if self.piece.is_empty() { skipped } else { 0 };
        self.at += bytes.len() as u64;
        if self.at > self.end {
            return Err(Error::other("a part was changed during the upload; push the recording again"));
        }
        let mut rest = bytes.get(skipped..).unwrap_or_default();
        while !rest.is_empty() {
            let (head, tail) = rest.split_at(rest.len().min(PIECE - self.piece.len()));
            self.piece.extend_from_slice(head);
            rest = tail;
            if self.piece.len() == PIECE {
                self.send()?;
            }
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}
