//! Locks of the values that the threads of policies share.

use std::sync::{Mutex, MutexGuard, PoisonError};

/// Locks; the values behind these mutexes are whole after every statement, so a panic elsewhere does not matter.
pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
