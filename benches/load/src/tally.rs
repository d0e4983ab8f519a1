//! What became of every call: how long it took, in which part of the test, or why it failed.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use gleaner_bench_serving::{
    Failure, Result,
    load::{quantile, times},
};
use gleaner_client::ClientError;
use tonic::{Code, Status};

/// Reasons to keep, of many.
const REASONS: usize = 20;

/// What a client does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(crate) enum Doing {
    Asking,
    Uploading,
    Acting,
}

/// A part of the test.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub(crate) enum Part {
    /// Counted nowhere.
    #[default]
    Between,
    /// One robot and nobody else.
    Alone,
    /// Every client at work.
    Crowd,
    /// The same, in turns with the next.
    Peaceful,
    /// And one that is hostile.
    Hostile,
    /// One robot beside those who hold connections.
    Besieged,
}

/// The count of all calls; clones share it.
#[derive(Clone, Default)]
pub(crate) struct Tally(Arc<Mutex<Inner>>);

#[derive(Default)]
struct Inner {
    part: Part,
    took: HashMap<(Doing, Part), Vec<Duration>>,
    limited: u64,
    failed: u64,
    reasons: Vec<String>,
}

impl Tally {
    /// A part of the test begins.
    pub(crate) fn begin(&self, part: Part) {
        self.inner().part = part;
    }

    /// Counts a call that began `since`. What no longer is of the part it began in is of neither.
    pub(crate) fn count<T>(&self, doing: Doing, (since, part): (Instant, Part), result: Result<T>) {
        let mut inner = self.inner();
        match result {
            Ok(_) if inner.part == part => inner.took.entry((doing, part)).or_default().push(since.elapsed()),
            Ok(_) => {}
            Err(error) if limit(&error) => inner.limited += 1,
            Err(error) => {
                inner.failed += 1;
                if inner.reasons.len() < REASONS {
                    inner.reasons.push(format!("{doing:?}: {error}"));
                }
            }
        }
    }

    /// The present, for [`Tally::count`].
    pub(crate) fn now(&self) -> (Instant, Part) {
        (Instant::now(), self.inner().part)
    }

    /// Calls counted, and of their times, in milliseconds, these parts.
    pub(crate) fn quantiles(&self, doing: Doing, part: Part, parts: [f64; 2]) -> (usize, [f64; 2]) {
        let took = self.inner().took.get(&(doing, part)).cloned().unwrap_or_default();
        let sorted = times(took.into_iter());
        (sorted.len(), parts.map(|part| quantile(&sorted, part)))
    }

    /// Calls that a limit refused, calls that failed otherwise, and why.
    pub(crate) fn refusals(&self) -> (u64, u64, Vec<String>) {
        let inner = self.inner();
        (inner.limited, inner.failed, inner.reasons.clone())
    }

    fn inner(&self) -> MutexGuard<'_, Inner> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Whether a limit of the server refused a call, and nothing is wrong.
fn limit(error: &Failure) -> bool {
    let status = match (error.downcast_ref::<Status>(), error.downcast_ref::<ClientError>()) {
        (Some(status), _) => Some(status),
        (None, Some(ClientError::Rejected(status))) => Some(&**status),
        (None, Some(_) | None) => None,
    };
    status.is_some_and(|status| status.code() == Code::ResourceExhausted)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_are_told_from_failures_and_parts_from_one_another() {
        let tally = Tally::default();
        tally.begin(Part::Crowd);
        let now = tally.now();
        tally.count(Doing::Asking, now, Ok(()));
        tally.count::<()>(Doing::Asking, now, Err(Status::resource_exhausted("too many").into()));
        tally.count::<()>(Doing::Uploading, now, Err(ClientError::from(Status::internal("no")).into()));
        tally.begin(Part::Hostile);
        tally.count(Doing::Asking, now, Ok(()));
        assert_eq!(tally.quantiles(Doing::Asking, Part::Crowd, [0.5, 0.99]).0, 1);
        assert_eq!(tally.quantiles(Doing::Asking, Part::Hostile, [0.5, 0.99]).0, 0);
        let (limited, failed, reasons) = tally.refusals();
        assert_eq!((limited, failed, reasons.len()), (1, 1, 1));
    }
}
