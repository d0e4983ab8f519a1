//! The id of the call that is being served: in its span, in what is logged of it, and in every error its caller gets.

use ulid::Ulid;

/// The metadata that says it to the caller of a call that failed.
pub(crate) const HEADER: &str = "request-id";

tokio::task_local! {
    static CURRENT: Ulid;
}

/// The id of the call that this code runs for; a new one where none does.
pub(crate) fn id() -> Ulid {
    CURRENT.try_with(|id| *id).unwrap_or_else(|_| Ulid::generate())
}

/// Runs `work` for the call with this id.
pub(super) fn within<T>(id: Ulid, work: impl FnOnce() -> T) -> T {
    CURRENT.sync_scope(id, work)
}
