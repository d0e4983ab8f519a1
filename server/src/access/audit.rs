//! Entries of the audit log on their way to the disk. Must not depend on pages or on any single rpc.
//!
//! The guard begins the entry of a call that it admits, or refuses by role. The method of the rpc adds the subjects and
//! writes the entry when the change is done. The guard writes the entry of every other call when its response ends, so
//! that calls whose request cannot be decoded, streams and calls whose caller has gone are in the log too.

use std::sync::{Arc, Mutex, PoisonError};

use tonic::Code;

use super::{
    caller::Caller,
    subjects::{Named, Subjects},
};
use crate::{
    domain::{access::AuditEntry, time::Millis},
    error::{Error, Result},
    store::Store,
};

/// An entry that is written once; clones share it.
#[derive(Clone)]
pub(crate) struct AuditDraft(Arc<Mutex<Option<Draft>>>);

struct Draft {
    store: Store,
    caller: Caller,
    peer: String,
    path: String,
    subjects: Subjects,
}

impl AuditDraft {
    /// The entry of the call of the rpc at `path`.
    pub(super) fn begin(store: Store, caller: Caller, peer: String, path: &str) -> Self {
        let draft = Draft { store, caller, peer, path: path.to_owned(), subjects: Subjects::default() };
        Self(Arc::new(Mutex::new(Some(draft))))
    }

    /// The entry of a request.
    ///
    /// # Errors
    /// Internal when no guard precedes the service, or the authorisation table does not audit the rpc.
    pub(crate) fn of<T>(request: &tonic::Request<T>) -> Result<Self> {
        let draft = request.extensions().get::<Self>().cloned();
        draft.ok_or_else(|| Error::internal("auditing a call", "its rpc is not audited"))
    }

    /// Adds the names and ids of a message to the subjects.
    pub(crate) fn about(&self, message: &impl Named) {
        if let Some(draft) = &mut *self.0.lock().unwrap_or_else(PoisonError::into_inner) {
            message.name_in("", &mut draft.subjects);
        }
    }

    /// Writes the entry, unless it is written already. The returned future completes once the entry is on disk; the write
    /// continues if that future is dropped.
    pub(crate) fn write(&self, code: Code) -> impl Future<Output = ()> + Send + use<> {
        let draft = self.0.lock().unwrap_or_else(PoisonError::into_inner).take();
        let writing = draft.map(|Draft { store, caller, peer, path, subjects }| {
            let outcome = if code == Code::Ok { "ok".to_owned() } else { format!("{code:?}") };
            // `/gleaner.v1.TaskService/CreateTask` becomes `TaskService/CreateTask`.
            let rpc = path.rsplit_once('.').map_or(path.as_str(), |(_, rpc)| rpc).to_owned();
            let (at, token_id, caller) = (Millis::now(), caller.token_id(), caller.name().to_owned());
            write(store, AuditEntry { at, token_id, caller, peer, rpc, subjects: subjects.into(), outcome })
        });
        async move {
            if let Some(writing) = writing {
                writing.await;
            }
        }
    }
}

/// The guard's end of an entry. Dropped before the response has ended, it writes that the call was cancelled.
pub(super) struct AuditGuard(pub(super) AuditDraft);

impl Drop for AuditGuard {
    fn drop(&mut self) {
        if tokio::runtime::Handle::try_current().is_ok() {
            drop(self.0.write(Code::Cancelled));
        }
    }
}

/// Writes an entry. The returned future completes once the entry is on disk; the write continues if that future is dropped.
/// The change stands if the entry cannot be written; the server's log then has the entry.
pub(crate) fn write(store: Store, entry: AuditEntry) -> impl Future<Output = ()> + Send + use<> {
    let writing = tokio::spawn(async move {
        if let Err(error) = store.insert_audit(&entry).await {
            tracing::error!(
                %error, audit.rpc = entry.rpc, audit.caller = entry.caller, audit.subjects = ?entry.subjects,
                audit.outcome = entry.outcome, "the audit log could not be written"
            );
        }
    });
    async move {
        // It fails only with the runtime.
        let _ = writing.await;
    }
}
