//! Loaded score runs. Each is loaded once for all callers that wait for it, stays while a caller holds it, and
//! otherwise as long as it is among the most recently used.

use std::{
    collections::HashMap,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use tokio::sync::{OnceCell, oneshot};
use tracing::Instrument as _;

use super::{Ready, model::Scorer};
use crate::{
    domain::id::ScoreRunId,
    error::{Error, Result},
    model_cache::ModelCache,
};

/// A load that callers share: it ends even if the caller that began it is gone.
type Load<S> = Arc<OnceCell<Arc<Ready<S>>>>;

/// Score runs in memory.
pub(super) struct LoadedRuns<S: Scorer>(Mutex<Runs<S>>);

struct Runs<S: Scorer> {
    /// Each weighs 1: the budget is a number of runs.
    ready: ModelCache<ScoreRunId, Ready<S>>,
    loading: HashMap<ScoreRunId, Load<S>>,
}

impl<S: Scorer> LoadedRuns<S> {
    /// `most`: runs in memory, unless more are held.
    pub(super) fn new(most: usize) -> Arc<Self> {
        let ready = ModelCache::new(most as u64);
        Arc::new(Self(Mutex::new(Runs { ready, loading: HashMap::new() })))
    }

    /// Returns a run, loaded with `load` if it is not in memory. A load continues without the caller that began it, for
    /// callers that come later.
    ///
    /// # Errors
    /// The error of `load`, after which the next waiting caller tries again; Unavailable after [`Self::stop`].
    pub(super) async fn ready<F>(
        self: &Arc<Self>,
        run: &ScoreRunId,
        load: impl FnOnce() -> F + Send + 'static,
    ) -> Result<Arc<Ready<S>>>
    where
        F: Future<Output = Result<Ready<S>>> + Send,
    {
        let cell = {
            let mut runs = self.runs();
            if let Some(ready) = runs.ready.get(run)? {
                return Ok(ready);
            }
            Arc::clone(runs.loading.entry(run.clone()).or_default())
        };
        let (sender, receiver) = oneshot::channel();
        let (runs, run) = (Arc::clone(self), run.clone());
        let loading = async move {
            let load = || async {
                // A caller that left while another caller's load failed needs no load of its own.
                if sender.is_closed() { Err(caller_is_gone()) } else { load().await.map(Arc::new) }
            };
            let loaded = cell.get_or_try_init(load).await.cloned();
            runs.finish(&run, cell, loaded.as_ref().ok());
            // The caller may be gone.
            let _ = sender.send(loaded);
            runs.make_room();
        };
        tokio::spawn(loading.in_current_span());
        let ready = receiver.await.map_err(|error| Error::internal("loading a scorer", error))??;
        // A load that ended after the stop must not outlive it.
        match self.runs().ready.is_stopped() {
            true => Err(Error::unavailable("the server is stopping; retry")),
            false => Ok(ready),
        }
    }

    /// Unloads idle runs, the least recently used first, until the budget holds.
    pub(super) fn make_room(&self) {
        // Dropped after the lock: giving memory back takes time.
        let unloaded = self.runs().ready.make_room(0);
        for (run, _ready) in unloaded {
            tracing::info!(score_run.id = %run, "scorer unloaded to make room");
        }
    }

    /// Removes and returns every run; later requests are refused.
    pub(super) fn stop(&self) -> Vec<Arc<Ready<S>>> {
        let mut runs = self.runs();
        runs.loading.clear();
        runs.ready.stop()
    }

    /// The runs in memory.
    #[cfg(test)]
    pub(super) fn loaded(&self) -> Vec<ScoreRunId> {
        self.runs().ready.keys()
    }

    /// Ends one caller's part in a load: the first to find it ready moves it to the cache, and the last removes a load
    /// that failed.
    fn finish(&self, run: &ScoreRunId, cell: Load<S>, ready: Option<&Arc<Ready<S>>>) {
        let mut runs = self.runs();
        let ours = runs.loading.get(run).is_some_and(|loading| Arc::ptr_eq(loading, &cell));
        drop(cell);
        let Some(loading) = runs.loading.get(run).filter(|_| ours) else { return };
        match ready {
            Some(ready) => {
                runs.loading.remove(run);
                runs.ready.insert(run.clone(), ready, 1);
                runs.ready.pin(run, ready);
            }
            None if Arc::strong_count(loading) == 1 => {
                runs.loading.remove(run);
            }
            None => {}
        }
    }

    fn runs(&self) -> MutexGuard<'_, Runs<S>> {
        // Whole after every statement, so a panic elsewhere does not spoil it.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn caller_is_gone() -> Error {
    Error::cancelled("the caller that requested the scorer is gone")
}
