//! The monitor: a channel that carries the working thread's events to the reporter, and a request to stop back.

use std::time::{Duration, Instant};

use gleaner_learn::Monitor;
use tokio::sync::{mpsc, oneshot};
use tokio_util::sync::CancellationToken;

use super::client::RETRY_FOR;
use gleaner_core::{
    error::{Kind, Result},
    id::BlobId,
};
use gleaner_data_folder::blobs::Blobs;

/// Maximum number of events queued for the reporter; beyond it the working thread waits.
const WAITING: usize = 1024;
/// Attempts to store a checkpoint that the cleanup of another job removes in between.
const TRIES: u32 = 3;
/// Interval between checks of the disk's free space.
#[cfg(not(test))]
const SPACE_POLL: Duration = Duration::from_secs(2);
#[cfg(test)]
const SPACE_POLL: Duration = Duration::from_millis(1);

/// Events of the working thread.
#[derive(Debug)]
pub(crate) enum Event {
    /// A new activity.
    Phase(String),
    /// Progress, with new values.
    Progress {
        /// Steps done.
        done: u64,
        /// Number of steps.
        total: u64,
        /// (name, value) at this step.
        metrics: Vec<(&'static str, f64)>,
    },
    /// A stored blob to resume from.
    Checkpoint {
        /// Steps done.
        step: u64,
        /// The blob.
        blob: BlobId,
        /// Receives true once the server names the blob, and false when the blob is gone.
        saved: oneshot::Sender<bool>,
    },
}

/// The working thread's side of the channel.
pub(crate) struct Watcher {
    events: mpsc::Sender<Event>,
    stop: CancellationToken,
    blobs: Blobs,
}

/// Both sides of a channel; the receiver yields events until the watcher is dropped.
pub(crate) fn channel(blobs: Blobs) -> (Watcher, mpsc::Receiver<Event>) {
    let (events, receiver) = mpsc::channel(WAITING);
    (Watcher { events, stop: CancellationToken::new(), blobs }, receiver)
}

impl Watcher {
    /// Cancelled when the work should stop.
    pub(crate) fn stop(&self) -> CancellationToken {
        self.stop.clone()
    }

    /// Reports a new activity.
    pub(crate) fn phase(&self, doing: &str) {
        tracing::info!("{doing}");
        self.send(Event::Phase(doing.to_owned()));
    }

    /// Stores blobs. On a full disk, or while the bucket of the blobs fails, the write is retried until it succeeds or the
    /// work should stop.
    ///
    /// # Errors
    /// Exhausted or Unavailable when that lasts long; other errors at once.
    pub(crate) fn retry_while_full<T>(&self, write: impl Fn(&Blobs) -> Result<T>) -> Result<T> {
        let begun = Instant::now();
        loop {
            match write(&self.blobs) {
                Err(error)
                    if matches!(error.kind(), Kind::Exhausted | Kind::Unavailable)
                        && begun.elapsed() < RETRY_FOR
                        && !self.cancelled() =>
                {
                    tracing::warn!(%error, "waiting until blobs can be stored");
                    // Neither a disk nor a bucket sends an event when it can be written again.
                    std::thread::park_timeout(SPACE_POLL);
                }
                done => return done,
            }
        }
    }

    fn send(&self, event: Event) {
        if self.events.blocking_send(event).is_err() {
            // Without the reporter there is no server, so no result could be sent.
            self.stop.cancel();
        }
    }
}

impl Monitor for Watcher {
    fn progress(&mut self, step: u64, total: u64, metrics: &[(&'static str, f64)]) {
        self.send(Event::Progress { done: step, total, metrics: metrics.to_vec() });
    }

    fn checkpoint(&mut self, step: u64, bytes: &[u8]) -> std::result::Result<(), String> {
        for _ in 0..TRIES {
            let blob = self.retry_while_full(|blobs| blobs.put(bytes)).map_err(|error| error.to_string())?;
            gleaner_data_folder::fail_point::pass("checkpoint.blob_kept");
            let (saved, answer) = oneshot::channel();
            self.send(Event::Checkpoint { step, blob, saved });
            if answer.blocking_recv().map_err(|_| "the server did not accept the checkpoint".to_owned())? {
                return Ok(());
            }
        }
        Err("the checkpoint was removed each time before the server stored its id".to_owned())
    }

    fn cancelled(&self) -> bool {
        self.stop.is_cancelled()
    }
}

#[cfg(test)]
mod tests {
    use std::sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    };

    use super::*;

    #[test]
    fn a_checkpoint_is_on_disk_before_it_is_named_and_waits_for_the_answer() {
        let dir = tempfile::tempdir().unwrap();
        let blobs = Blobs::open(dir.path()).unwrap();
        let (mut watcher, mut events) = channel(blobs.clone());
        let server = std::thread::spawn(move || {
            // The first response reports a removed blob, so the blob is stored again.
            for there in [false, true] {
                let Event::Checkpoint { step, blob, saved } = events.blocking_recv().unwrap() else {
                    panic!("a checkpoint was expected")
                };
                assert_eq!((step, blobs.get(&blob).unwrap()), (5, b"weights".to_vec()));
                std::fs::remove_file(blobs.path(&blob)).unwrap();
                saved.send(there).unwrap();
            }
        });
        watcher.checkpoint(5, b"weights").unwrap();
        server.join().unwrap();
        assert!(watcher.checkpoint(6, b"more").is_err(), "the server is gone");
        assert!(watcher.cancelled(), "work without a server is stopped");
    }

    #[test]
    fn writes_wait_for_free_disk_space() {
        let dir = tempfile::tempdir().unwrap();
        let free = Arc::new(AtomicU64::new(0));
        let blobs = Blobs::open(dir.path()).unwrap().sparing(100).playing(&free);
        let (watcher, _events) = channel(blobs);
        let tries = std::cell::Cell::new(0);
        let blob = watcher.retry_while_full(|blobs| {
            tries.set(tries.get() + 1);
            let put = blobs.put(b"weights");
            free.store(u64::MAX, Ordering::Relaxed);
            put
        });
        assert!(blob.is_ok() && tries.get() == 2, "{tries:?}");
        free.store(0, Ordering::Relaxed);
        watcher.stop().cancel();
        assert_eq!(watcher.retry_while_full(|blobs| blobs.put(b"more")).unwrap_err().kind(), Kind::Exhausted);
    }
}
