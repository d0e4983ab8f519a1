//! A recording's bytes as messages, read as the connection takes them.

mod joined;

use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

use bytes::{Bytes, BytesMut};
use futures::Stream;
use futures::future::Either;
use tokio::io::{AsyncReadExt as _, AsyncSeekExt as _};

use super::Progress;
use crate::error::{ClientError, Result};
use crate::file::open_regular;
use crate::source::Files;

// Half of the server's message limit.
pub(super) const PIECE: usize = 1 << 20;

/// The range of bytes to send.
pub(crate) struct Pieces {
    /// The first byte.
    pub(crate) offset: u64,
    /// The end of the range, or the file's end if that comes first.
    pub(crate) end: u64,
    pub(crate) progress: Progress,
    pub(crate) failure: ReadFailure,
}

impl Pieces {
    /// The pieces of a file, or of the join of several.
    pub(crate) async fn of_files(self, files: Files) -> Result<impl Stream<Item = (u64, Bytes)> + Send + use<>> {
        Ok(match files {
            Files::One(path) => Either::Left(self.of(path).await?),
            Files::Parts(parts) => Either::Right(joined::pieces(self, parts)),
        })
    }

    /// Opens the file and returns its pieces, each with its offset.
    pub(crate) async fn of(self, path: PathBuf) -> Result<impl Stream<Item = (u64, Bytes)> + Send + use<>> {
        let mut file = tokio::fs::File::from_std(open_regular(&path)?);
        let sought = file.seek(std::io::SeekFrom::Start(self.offset)).await;
        sought.map_err(|source| ClientError::Io { path, source })?;
        Ok(futures::stream::unfold((self, file), |(mut pieces, mut file)| async move {
            let piece = pieces.next(&mut file).await?;
            Some((piece, (pieces, file)))
        }))
    }

    async fn next(&mut self, file: &mut tokio::fs::File) -> Option<(u64, Bytes)> {
        let data = match read_piece(file, self.end.saturating_sub(self.offset)).await {
            Ok(data) if data.is_empty() => return None,
            Ok(data) => data.freeze(),
            Err(error) => {
                self.failure.set(error);
                return None;
            }
        };
        let offset = self.offset;
        self.offset += data.len() as u64;
        (self.progress)(self.offset);
        Some((offset, data))
    }
}

async fn read_piece(file: &mut tokio::fs::File, left: u64) -> std::io::Result<BytesMut> {
    let wanted = usize::try_from(left).map_or(PIECE, |left| left.min(PIECE));
    let mut data = BytesMut::zeroed(wanted);
    let mut filled = 0;
    while filled < wanted {
        match file.read(&mut data[filled..]).await? {
            0 => break,
            read => filled += read,
        }
    }
    data.truncate(filled);
    Ok(data)
}

// A request stream cannot carry an error, so a failed read is stored here and read after the call.
#[derive(Clone, Default)]
pub(crate) struct ReadFailure(Arc<Mutex<Option<std::io::Error>>>);

impl ReadFailure {
    fn set(&self, error: std::io::Error) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(error);
    }

    pub(crate) fn take(&self) -> Option<std::io::Error> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).take()
    }
}
