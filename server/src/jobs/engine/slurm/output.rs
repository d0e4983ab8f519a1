//! The output of a worker on a node: a file on the shared file system, read as it grows. Its end is the worker's, as the
//! engine sees it. The position is stored beside it, so that a restarted server repeats no line.

use std::{
    io::SeekFrom,
    path::{Path, PathBuf},
    time::Duration,
};

use tokio::{
    fs::File,
    io::{AsyncReadExt as _, AsyncSeekExt as _, AsyncWriteExt as _, DuplexStream},
};
use tokio_util::{sync::CancellationToken, task::AbortOnDropHandle};

/// Interval of looking at the file, which may be on another machine's disk.
const EVERY: Duration = Duration::from_millis(500);
/// Bytes that are read at once.
const PART: usize = 64 << 10;

/// Reads a file until its worker has ended.
pub(super) struct Following {
    /// Cancelled once the worker has ended.
    ended: CancellationToken,
    _reading: AbortOnDropHandle<()>,
}

impl Following {
    /// Begins to read a file, which may not exist yet; the second value yields its content.
    pub(super) fn start(path: PathBuf) -> (Self, DuplexStream) {
        let (mut sink, source) = tokio::io::duplex(PART);
        let ended = CancellationToken::new();
        let last = ended.clone();
        let reading = tokio::spawn(async move {
            let position = path.with_extension("read");
            loop {
                let over = last.is_cancelled();
                // A file that cannot be read now may be readable later; the worker does not depend on it.
                let read = pass_on(&path, &position, &mut sink).await;
                if over {
                    break;
                }
                if let Err(error) = read {
                    tracing::debug!(%error, "the output of a worker cannot be read");
                }
                let _ = last.run_until_cancelled(tokio::time::sleep(EVERY)).await;
            }
            for file in [&path, &position] {
                let _ = tokio::fs::remove_file(file).await;
            }
        });
        (Self { ended, _reading: AbortOnDropHandle::new(reading) }, source)
    }

    /// Reads the rest of the file, then ends and removes it.
    pub(super) fn end(&self) {
        self.ended.cancel();
    }
}

/// Passes on what the file has gained since the stored position.
async fn pass_on(path: &Path, position: &Path, sink: &mut DuplexStream) -> std::io::Result<()> {
    let mut file = File::open(path).await?;
    let stored = tokio::fs::read_to_string(position).await.unwrap_or_default();
    let mut at: u64 = stored.trim().parse().unwrap_or(0);
    file.seek(SeekFrom::Start(at)).await?;
    let mut part = vec![0; PART];
    loop {
        let read = file.read(&mut part).await?;
        if read == 0 {
            return Ok(());
        }
        sink.write_all(part.get(..read).unwrap_or_default()).await?;
        at += read as u64;
        tokio::fs::write(position, at.to_string()).await?;
    }
}
