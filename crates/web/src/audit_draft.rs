//! The audit entry of a request, from its beginning to the disk.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use axum::http::StatusCode;
use gleaner_core::{access::AuditEntry, time::Millis};
use gleaner_edge::ConnectionState;

use super::{Backend, Caller, page::Page};

/// The most characters of a value in the audit log.
const LONGEST: usize = 160;

/// The audit entry of a request. It is written once; clones share it.
///
/// The middleware begins it. A page that changes something names the subjects and writes it when the change is done.
/// The middleware writes it for requests that no page received: those of callers without the role, and malformed ones.
#[derive(Debug, Clone)]
pub(super) struct AuditDraft(Arc<Mutex<Option<AuditEntry>>>);

impl AuditDraft {
    /// The entry of a request for this page.
    pub(super) fn begin(page: Page, caller: &Caller, connection: &ConnectionState) -> Self {
        Self(Arc::new(Mutex::new(Some(AuditEntry {
            at: Millis::now(),
            token_id: caller.token_id().cloned(),
            caller: caller.name().to_owned(),
            peer: connection.peer().to_string(),
            rpc: format!("pages/{page:?}"),
            subjects: Vec::new(),
            outcome: String::new(),
        }))))
    }

    /// Adds a subject: a field and its value as sent.
    pub(super) fn about(&self, field: &str, value: &str) {
        if let Some(entry) = &mut *self.entry() {
            entry.subjects.push(subject(field, value));
        }
    }

    /// Writes the entry with the outcome of a response of this status, unless it is written already.
    pub(super) async fn write(&self, backend: &dyn Backend, status: StatusCode) {
        let entry = self.entry().take();
        if let Some(entry) = entry {
            let done = status.is_success() || status.is_redirection();
            let outcome = if done { "ok" } else { status.canonical_reason().unwrap_or("refused") };
            backend.audit(AuditEntry { at: Millis::now(), outcome: outcome.to_owned(), ..entry }).await;
        }
    }

    fn entry(&self) -> MutexGuard<'_, Option<AuditEntry>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// `field=value`, escaped for display: control characters would reach a terminal.
fn subject(field: &str, value: &str) -> String {
    format!("{field}={}", value.escape_debug().take(LONGEST).collect::<String>())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn subjects_are_shortened_and_escaped() {
        let long = subject("job_id", &"\u{1b}[2J\n".repeat(1000));
        assert_eq!(subject("task", "reach"), "task=reach");
        assert_eq!(long.len(), "job_id=".len() + LONGEST);
        assert!(long.starts_with("job_id=\\u{1b}[2J\\n") && !long.contains(char::is_control));
    }
}
