//! Statistics of calls: times by kind and phase, rejections and failures.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use gleaner_bench_serving::{
    Failure, Result,
    load::{quantile, times},
};
use gleaner_client::ClientError;
use tonic::{Code, Status};

/// The number of errors that are kept.
const REASONS: usize = 20;

/// The kind of a client's call.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(crate) enum CallKind {
    Query,
    Upload,
    Act,
}

/// A phase of the test.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub(crate) enum Phase {
    /// Between phases; its calls are not counted.
    #[default]
    Between,
    /// One robot.
    Alone,
    /// All clients.
    Load,
    /// All clients, alternately with the next phase.
    Baseline,
    /// All clients and a hostile one.
    Hostile,
    /// One robot beside held connections.
    Held,
}

/// The statistics of all calls; clones share them.
#[derive(Clone, Default)]
pub(crate) struct Stats(Arc<Mutex<Inner>>);

#[derive(Default)]
struct Inner {
    phase: Phase,
    took: HashMap<(CallKind, Phase), Vec<Duration>>,
    limited: u64,
    failed: u64,
    reasons: Vec<String>,
}

impl Stats {
    /// Starts a phase.
    pub(crate) fn begin(&self, phase: Phase) {
        self.inner().phase = phase;
    }

    /// Counts a call that started at `since`. A call that ends in another phase than it started in is not counted.
    pub(crate) fn count<T>(&self, kind: CallKind, (since, phase): (Instant, Phase), result: Result<T>) {
        let mut inner = self.inner();
        match result {
            Ok(_) if inner.phase == phase => inner.took.entry((kind, phase)).or_default().push(since.elapsed()),
            Ok(_) => {}
            Err(error) if is_limit(&error) => inner.limited += 1,
            Err(error) => {
                inner.failed += 1;
                if inner.reasons.len() < REASONS {
                    inner.reasons.push(format!("{kind:?}: {error}"));
                }
            }
        }
    }

    /// The current time and phase, for [`Stats::count`].
    pub(crate) fn now(&self) -> (Instant, Phase) {
        (Instant::now(), self.inner().phase)
    }

    /// The number of counted calls, and these quantiles of their times in milliseconds.
    pub(crate) fn quantiles(&self, kind: CallKind, phase: Phase, quantiles: [f64; 2]) -> (usize, [f64; 2]) {
        let took = self.inner().took.get(&(kind, phase)).cloned().unwrap_or_default();
        let sorted = times(took.into_iter());
        (sorted.len(), quantiles.map(|part| quantile(&sorted, part)))
    }

    /// Calls that a limit rejected, calls that failed otherwise, and their errors.
    pub(crate) fn failures(&self) -> (u64, u64, Vec<String>) {
        let inner = self.inner();
        (inner.limited, inner.failed, inner.reasons.clone())
    }

    fn inner(&self) -> MutexGuard<'_, Inner> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Whether a limit of the server rejected a call.
fn is_limit(error: &Failure) -> bool {
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
    fn rejections_by_limits_are_not_failures_and_phases_are_separate() {
        let stats = Stats::default();
        stats.begin(Phase::Load);
        let now = stats.now();
        stats.count(CallKind::Query, now, Ok(()));
        stats.count::<()>(CallKind::Query, now, Err(Status::resource_exhausted("too many").into()));
        stats.count::<()>(CallKind::Upload, now, Err(ClientError::from(Status::internal("no")).into()));
        stats.begin(Phase::Hostile);
        stats.count(CallKind::Query, now, Ok(()));
        assert_eq!(stats.quantiles(CallKind::Query, Phase::Load, [0.5, 0.99]).0, 1);
        assert_eq!(stats.quantiles(CallKind::Query, Phase::Hostile, [0.5, 0.99]).0, 0);
        let (limited, failed, reasons) = stats.failures();
        assert_eq!((limited, failed, reasons.len()), (1, 1, 1));
    }
}
