//! Whether a server leads, which writes and runs jobs, or follows the leader of its database. Must not depend on SQL.

use std::sync::{
    Mutex, PoisonError,
    atomic::{AtomicU8, Ordering},
};

use tokio_util::sync::CancellationToken;

use super::sql::Pool;
use crate::error::{Error, Result};

const FOLLOWS: u8 = 0;
/// It repairs what the leader before it has left.
const TAKES_OVER: u8 = 1;
const LEADS: u8 = 2;

/// The role of a server that was started as a standby.
#[derive(Debug)]
pub(super) struct Role {
    /// For the entries that a standby writes.
    pub(super) beside: Pool,
    stage: AtomicU8,
    /// The address of the leader, as it was last seen.
    leader: Mutex<Option<String>>,
    /// Cancelled when this server leads.
    leads: CancellationToken,
}

impl Role {
    /// The role of a standby.
    pub(super) fn standby(beside: Pool) -> Self {
        Self { beside, stage: AtomicU8::new(FOLLOWS), leader: Mutex::default(), leads: CancellationToken::new() }
    }

    /// Notes the address of the leader; `None` while no server leads.
    pub(super) fn note_leader(&self, address: Option<String>) {
        *self.leader.lock().unwrap_or_else(PoisonError::into_inner) = address;
    }

    /// Whether another server leads, as it was last seen.
    pub(super) fn has_leader(&self) -> bool {
        self.leader.lock().unwrap_or_else(PoisonError::into_inner).is_some()
    }

    /// Writes no more.
    pub(super) fn follow(&self) {
        self.stage.store(FOLLOWS, Ordering::SeqCst);
    }

    /// Permits the writes of this server's own repairs.
    pub(super) fn take_over(&self) {
        self.stage.store(TAKES_OVER, Ordering::SeqCst);
    }

    /// Permits all writes.
    pub(super) fn lead(&self) {
        self.stage.store(LEADS, Ordering::SeqCst);
        self.leads.cancel();
    }

    /// Returns when this server leads.
    pub(super) async fn leads(&self) {
        self.leads.cancelled().await;
    }

    /// Rejects a change unless this server leads.
    pub(super) fn expect_leader(&self) -> Result<()> {
        if self.stage.load(Ordering::SeqCst) == LEADS { Ok(()) } else { Err(self.refusal()) }
    }

    /// Rejects a write unless this server leads or takes over.
    pub(super) fn expect_writer(&self) -> Result<()> {
        if self.stage.load(Ordering::SeqCst) == FOLLOWS { Err(self.refusal()) } else { Ok(()) }
    }

    fn refusal(&self) -> Error {
        match &*self.leader.lock().unwrap_or_else(PoisonError::into_inner) {
            Some(address) => Error::precondition(format!(
                "this server is a standby, which serves reads and sessions without recording: send this call to the leader \
                 at {address}"
            )),
            None => Error::unavailable(
                "this server is a standby, and no server leads at the moment: it takes over once the locks of the leader are \
                 released; retry",
            ),
        }
    }
}
