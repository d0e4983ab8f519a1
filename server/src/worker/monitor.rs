//! The monitor: carries what the working thread says to the reporter, and a wish to stop back.

use gleaner_learn::Monitor;
use tokio::sync::{mpsc, oneshot};
use tokio_util::sync::CancellationToken;

use crate::{blobs::Blobs, domain::id::BlobId};

/// Events that may wait for the reporter; then the working thread waits.
const WAITING: usize = 1024;

/// What the working thread says.
#[derive(Debug)]
pub(super) enum Event {
    /// What it does from now on.
    Phase(String),
    /// How far it is, with new values.
    Progress {
        /// Steps done.
        done: u64,
        /// Steps in all.
        total: u64,
        /// (name, value) at this step.
        metrics: Vec<(&'static str, f64)>,
    },
    /// A blob that is on disk and to be resumed from.
    Checkpoint {
        /// Steps done.
        step: u64,
        /// The blob.
        blob: BlobId,
        /// Answered once the server names it.
        saved: oneshot::Sender<()>,
    },
}

/// The working thread's end.
pub(super) struct Watcher {
    events: mpsc::Sender<Event>,
    stop: CancellationToken,
    blobs: Blobs,
}

/// Both ends; the second gives events until the watcher is dropped.
pub(super) fn channel(blobs: Blobs) -> (Watcher, mpsc::Receiver<Event>) {
    let (events, receiver) = mpsc::channel(WAITING);
    (Watcher { events, stop: CancellationToken::new(), blobs }, receiver)
}

impl Watcher {
    /// Cancelled when the work should stop.
    pub(super) fn stop(&self) -> CancellationToken {
        self.stop.clone()
    }

    /// Says what is done from now on.
    pub(super) fn phase(&self, doing: &str) {
        self.say(Event::Phase(doing.to_owned()));
    }

    fn say(&self, event: Event) {
        if self.events.blocking_send(event).is_err() {
            // The reporter is gone, so the server is: nobody would take a result.
            self.stop.cancel();
        }
    }
}

impl Monitor for Watcher {
    fn progress(&mut self, step: u64, total: u64, metrics: &[(&'static str, f64)]) {
        self.say(Event::Progress { done: step, total, metrics: metrics.to_vec() });
    }

    fn checkpoint(&mut self, step: u64, bytes: &[u8]) -> Result<(), String> {
        let blob = self.blobs.put(bytes).map_err(|error| error.to_string())?;
        crate::fail_point::pass("checkpoint.blob_kept");
        let (saved, answer) = oneshot::channel();
        self.say(Event::Checkpoint { step, blob, saved });
        answer.blocking_recv().map_err(|_| "the server did not take it".to_owned())
    }

    fn cancelled(&self) -> bool {
        self.stop.is_cancelled()
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::panic)]
    use super::*;

    #[test]
    fn a_checkpoint_is_on_disk_before_it_is_named_and_waits_for_the_answer() {
        let dir = tempfile::tempdir().unwrap();
        let blobs = Blobs::open(dir.path()).unwrap();
        let (mut watcher, mut events) = channel(blobs.clone());
        let server = std::thread::spawn(move || match events.blocking_recv().unwrap() {
            Event::Checkpoint { step, blob, saved } => {
                assert_eq!((step, blobs.get(&blob).unwrap()), (5, b"weights".to_vec()));
                saved.send(()).unwrap();
            }
            Event::Phase(_) | Event::Progress { .. } => panic!("a checkpoint was expected"),
        });
        watcher.checkpoint(5, b"weights").unwrap();
        server.join().unwrap();
        assert!(watcher.checkpoint(6, b"more").is_err(), "nobody takes it");
        assert!(watcher.cancelled(), "work without a server is in vain");
    }
}
