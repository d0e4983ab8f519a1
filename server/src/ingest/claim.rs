//! Who may write an upload: one at a time, and the newest comer wins.
//!
//! A client whose connection broke comes back before the server has noticed. So a new claim does not wait for
//! the old stream to time out: it tells that one to leave, and waits only until it has.

use std::{
    collections::HashMap,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use tokio::sync::OwnedMutexGuard;
use tokio_util::sync::CancellationToken;

use crate::domain::id::UploadId;

/// How long an upload that was offered to one client is not offered to another one.
const OFFER: Duration = Duration::from_secs(10);

/// The claims on all open uploads; clones share them.
#[derive(Debug, Clone, Default)]
pub(super) struct Claims(Arc<Mutex<HashMap<UploadId, Holder>>>);

#[derive(Debug, Default)]
struct Holder {
    lock: Arc<tokio::sync::Mutex<()>>,
    leave: CancellationToken,
    offered: Option<Instant>,
}

/// The right to write one upload, until it is dropped.
#[derive(Debug)]
pub(super) struct Claim {
    _held: OwnedMutexGuard<()>,
    /// Cancelled when somebody else wants to write.
    pub(super) leave: CancellationToken,
}

impl Claims {
    /// Takes an upload over: tells its present holder to leave and waits until it has.
    pub(super) async fn take(&self, id: &UploadId) -> Claim {
        let (lock, leave) = {
            let mut holders = self.holders();
            let holder = holders.entry(id.clone()).or_default();
            holder.leave.cancel();
            holder.leave = CancellationToken::new();
            holder.offered = None;
            (Arc::clone(&holder.lock), holder.leave.clone())
        };
        Claim { _held: lock.lock_owned().await, leave }
    }

    /// Offers an upload to a client that may go on with it. False when another one is at it: two clients that
    /// push the same file must not take one upload from each other in turns.
    pub(super) fn offer(&self, id: &UploadId) -> bool {
        let mut holders = self.holders();
        let holder = holders.entry(id.clone()).or_default();
        let offered = holder.offered.is_some_and(|since| since.elapsed() < OFFER);
        if offered || holder.lock.try_lock().is_err() {
            return false;
        }
        holder.offered = Some(Instant::now());
        true
    }

    /// Forgets an upload that is not open any more.
    pub(super) fn forget(&self, id: &UploadId) {
        self.holders().remove(id);
    }

    fn holders(&self) -> MutexGuard<'_, HashMap<UploadId, Holder>> {
        // The map is whole after every statement, so a panic elsewhere does not spoil it.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn the_newest_comer_wins_once_the_old_one_has_left() {
        let (claims, id) = (Claims::default(), UploadId::new());
        let first = claims.take(&id).await;
        assert!(!claims.offer(&id), "somebody writes it");
        let second = claims.take(&id);
        tokio::pin!(second);
        assert!(futures::poll!(&mut second).is_pending());
        assert!(first.leave.is_cancelled());
        drop(first);
        let second = second.await;
        assert!(!second.leave.is_cancelled());
        drop(second);
        assert!(claims.offer(&id));
        assert!(!claims.offer(&id), "offered to another one a moment ago");
        drop(claims.take(&id).await);
        assert!(claims.offer(&id), "who was offered it has been and gone");
    }
}
