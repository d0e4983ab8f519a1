//! Claims on uploads: one writer at a time, and the newest claimant wins.
//!
//! A client whose connection broke comes back before the server has noticed. So a new claim does not wait for the old
//! stream to time out: it requests that the holder leave, and waits only for that.

use std::{
    collections::HashMap,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use tokio::sync::{OwnedMutexGuard, watch};
use tokio_util::sync::CancellationToken;

use crate::domain::id::UploadId;

/// How long the holder of an upload, or a client it was offered to, may be inactive until it is offered to another.
const PATIENCE: Duration = Duration::from_secs(5);

/// The claims on all open uploads; clones share them.
#[derive(Debug, Clone)]
pub(super) struct Claims {
    holders: Arc<Mutex<HashMap<UploadId, Holder>>>,
    patience: Duration,
}

#[derive(Debug, Default)]
struct Holder {
    lock: Arc<tokio::sync::Mutex<()>>,
    leave: CancellationToken,
    offered: Option<Instant>,
    /// Updated at each activity.
    life: watch::Sender<()>,
}

impl Holder {
    fn is_idle(&self, patience: Duration) -> bool {
        self.offered.is_none_or(|since| since.elapsed() >= patience) && self.lock.try_lock().is_ok()
    }
}

/// The right to write one upload, released on drop.
#[derive(Debug)]
pub(super) struct Claim {
    _held: OwnedMutexGuard<()>,
    /// Cancelled when another client claims the upload.
    pub(super) leave: CancellationToken,
    life: watch::Sender<()>,
}

impl Claim {
    /// Notes activity: bytes have arrived.
    pub(super) fn alive(&self) {
        self.life.send_replace(());
    }
}

impl Default for Claims {
    fn default() -> Self {
        Self::with_patience(PATIENCE)
    }
}

impl Claims {
    pub(super) fn with_patience(patience: Duration) -> Self {
        Self { holders: Arc::default(), patience }
    }

    /// Takes an upload over: requests that its holder leave, and waits for that.
    pub(super) async fn take(&self, id: &UploadId) -> Claim {
        let (lock, leave, life) = {
            let mut holders = self.holders();
            let holder = holders.entry(id.clone()).or_default();
            holder.leave.cancel();
            holder.leave = CancellationToken::new();
            holder.offered = None;
            (Arc::clone(&holder.lock), holder.leave.clone(), holder.life.clone())
        };
        let claim = Claim { _held: lock.lock_owned().await, leave, life };
        claim.alive();
        claim
    }

    /// Offers an upload to a client that may resume it. False while another one is active: two clients that push the
    /// same file must not take one upload from each other in turns. A dead client whose connection still looks open
    /// blocks its successor only briefly.
    pub(super) async fn offer(&self, id: &UploadId) -> bool {
        let Some((lock, mut life)) = self.offer_at_once(id) else { return true };
        let left = async {
            // The present holder. A client that was offered the upload and has not come yet holds no claim.
            if lock.try_lock().is_err() {
                drop(lock.lock().await);
            } else {
                std::future::pending::<()>().await;
            }
        };
        tokio::select! {
            biased;
            // An error means that the upload is over.
            _ = life.changed() => false,
            () = left => self.offer_at_once(id).is_none(),
            () = tokio::time::sleep(self.patience) => {
                self.promise(id);
                true
            }
        }
    }

    /// Notes that a client was given an upload that no other client knows.
    pub(super) fn promise(&self, id: &UploadId) {
        self.holders().entry(id.clone()).or_default().offered = Some(Instant::now());
    }

    /// Whether an upload is neither written nor offered.
    pub(super) fn is_idle(&self, id: &UploadId) -> bool {
        self.holders().get(id).is_none_or(|holder| holder.is_idle(self.patience))
    }

    /// `None` when the caller has it now; otherwise the event to wait for.
    fn offer_at_once(&self, id: &UploadId) -> Option<(Arc<tokio::sync::Mutex<()>>, watch::Receiver<()>)> {
        let mut holders = self.holders();
        let holder = holders.entry(id.clone()).or_default();
        if holder.is_idle(self.patience) {
            holder.offered = Some(Instant::now());
            return None;
        }
        Some((Arc::clone(&holder.lock), holder.life.subscribe()))
    }

    /// Removes a closed upload.
    pub(super) fn forget(&self, id: &UploadId) {
        self.holders().remove(id);
    }

    fn holders(&self) -> MutexGuard<'_, HashMap<UploadId, Holder>> {
        // The map is whole after every statement, so a panic elsewhere does not spoil it.
        self.holders.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn the_newest_claimant_wins_once_the_old_one_has_left() {
        let (claims, id) = (Claims::default(), UploadId::new());
        let first = claims.take(&id).await;
        let second = claims.take(&id);
        tokio::pin!(second);
        assert!(futures::poll!(&mut second).is_pending());
        assert!(first.leave.is_cancelled());
        drop(first);
        let second = second.await;
        assert!(!second.leave.is_cancelled());
        drop(second);
        assert!(claims.offer(&id).await);
        drop(claims.take(&id).await);
        assert!(claims.offer(&id).await, "the client it was offered to has left");
    }

    /// Two clients push one file; a third comes after one has died silently.
    #[tokio::test(start_paused = true)]
    async fn an_active_client_keeps_its_upload_and_an_inactive_one_loses_it() {
        let (claims, id) = (Claims::default(), UploadId::new());
        let held = claims.take(&id).await;
        let offer = claims.offer(&id);
        tokio::pin!(offer);
        assert!(futures::poll!(&mut offer).is_pending());
        held.alive();
        assert!(!offer.await, "it is being written");

        let begun = tokio::time::Instant::now();
        assert!(claims.offer(&id).await, "its writer is inactive");
        assert_eq!(begun.elapsed(), PATIENCE);
        drop(held);

        let offer = claims.offer(&id);
        tokio::pin!(offer);
        assert!(futures::poll!(&mut offer).is_pending(), "offered to another one a moment ago");
        drop(claims.take(&id).await);
        assert!(!offer.await, "the other client has come");
    }

    #[tokio::test]
    async fn a_client_that_leaves_frees_its_upload_at_once() {
        let (claims, id) = (Claims::default(), UploadId::new());
        let held = claims.take(&id).await;
        let offer = claims.offer(&id);
        tokio::pin!(offer);
        assert!(futures::poll!(&mut offer).is_pending());
        drop(held);
        assert!(offer.await);
    }
}
