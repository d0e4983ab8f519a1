//! The id of the call being served: in its span, its log events, and every error sent to its caller.

use ulid::Ulid;

/// The metadata key of the id in a failed call's response.
pub(crate) const HEADER: &str = "request-id";

tokio::task_local! {
    static CURRENT: Ulid;
}

/// The id of the call that this code runs for; a new one outside of calls.
pub(crate) fn id() -> Ulid {
    CURRENT.try_with(|id| *id).unwrap_or_else(|_| Ulid::generate())
}

/// Runs `work` for the call with this id.
pub(super) fn within<T>(id: Ulid, work: impl FnOnce() -> T) -> T {
    CURRENT.sync_scope(id, work)
}
