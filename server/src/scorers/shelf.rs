//! Which runs are in memory: each is loaded once, kept while somebody holds it, and otherwise as long as it is among
//! the most recently used.

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
};

/// What is loaded.
pub(super) struct Shelf<S: Scorer> {
    /// Most runs in memory, unless more are held.
    most: usize,
    slots: Mutex<Slots<S>>,
}

struct Slots<S: Scorer> {
    by_run: HashMap<ScoreRunId, Slot<S>>,
    /// Counts uses, to tell which was least recent.
    uses: u64,
    stopped: bool,
}

struct Slot<S: Scorer> {
    /// Who comes while it is loaded waits for that, not for a load of its own.
    ready: Arc<OnceCell<Arc<Ready<S>>>>,
    /// Which use was its last.
    used: u64,
}

impl<S: Scorer> Slot<S> {
    /// Whether nobody but the shelf holds it, and `parting`, who is about to let go. Only with the shelf locked, so
    /// that nobody takes it meanwhile.
    fn is_idle(&self, parting: Option<&Arc<Ready<S>>>) -> bool {
        self.ready.get().is_some_and(|ready| {
            let parting = usize::from(parting.is_some_and(|parting| Arc::ptr_eq(parting, ready)));
            Arc::strong_count(ready) == 1 + parting && Arc::strong_count(&self.ready) == 1
        })
    }
}

impl<S: Scorer> Shelf<S> {
    pub(super) fn new(most: usize) -> Arc<Self> {
        let slots = Slots { by_run: HashMap::new(), uses: 0, stopped: false };
        Arc::new(Self { most, slots: Mutex::new(slots) })
    }

    /// The run, made by `load` if it is not there. A load that has begun is ended even if who asked for it has gone,
    /// for the next who asks.
    ///
    /// # Errors
    /// What `load` says, after which the next who waits tries again; Unavailable when nothing may be loaded any more.
    pub(super) async fn ready<F>(
        self: &Arc<Self>,
        run: &ScoreRunId,
        load: impl FnOnce() -> F + Send + 'static,
    ) -> Result<Arc<Ready<S>>>
    where
        F: Future<Output = Result<Ready<S>>> + Send,
    {
        let slot = {
            let mut slots = self.slots();
            if slots.stopped {
                return Err(stopping());
            }
            slots.uses += 1;
            let used = slots.uses;
            let slot = slots.by_run.entry(run.clone()).or_insert_with(|| Slot { ready: Arc::default(), used });
            slot.used = used;
            Arc::clone(&slot.ready)
        };
        let (tell, told) = oneshot::channel();
        let (shelf, run) = (Arc::clone(self), run.clone());
        let making = async move {
            let make = || async {
                // Who has gone while another's load failed wants none of their own.
                if tell.is_closed() { Err(gone()) } else { load().await.map(Arc::new) }
            };
            let made = slot.get_or_try_init(make).await.cloned();
            drop(slot);
            if made.is_err() {
                shelf.forget_unmade(&run);
            }
            // Nobody listens when the caller has gone.
            let _ = tell.send(made);
            shelf.make_room(None);
        };
        tokio::spawn(making.in_current_span());
        let ready = told.await.map_err(|error| Error::internal("loading a scorer", error))??;
        // A load that ended after the stop must not outlive it.
        match self.slots().stopped {
            true => Err(stopping()),
            false => Ok(ready),
        }
    }

    /// Unloads what was used least recently and nobody holds, until no more than the most are loaded.
    pub(super) fn make_room(&self, parting: Option<&Arc<Ready<S>>>) {
        let mut unloaded = Vec::new();
        let mut slots = self.slots();
        while slots.by_run.values().filter(|slot| slot.ready.initialized()).count() > self.most {
            let idle = slots.by_run.iter().filter(|(_, slot)| slot.is_idle(parting));
            let Some(oldest) = idle.min_by_key(|(_, slot)| slot.used).map(|(run, _)| run.clone()) else { break };
            tracing::info!(score_run.id = %oldest, "scorer unloaded to make room");
            unloaded.extend(slots.by_run.remove(&oldest));
        }
        // The shelf is not held while memory is given back.
        drop(slots);
    }

    /// Takes everything away; nothing may be loaded any more.
    pub(super) fn stop(&self) -> Vec<Arc<Ready<S>>> {
        let mut slots = self.slots();
        slots.stopped = true;
        slots.by_run.drain().filter_map(|(_, slot)| slot.ready.get().cloned()).collect()
    }

    /// The runs in memory.
    #[cfg(test)]
    pub(super) fn loaded(&self) -> Vec<ScoreRunId> {
        let slots = self.slots();
        slots.by_run.iter().filter(|(_, slot)| slot.ready.initialized()).map(|(run, _)| run.clone()).collect()
    }

    /// A load failed: its place goes, unless somebody tries again.
    fn forget_unmade(&self, run: &ScoreRunId) {
        let mut slots = self.slots();
        let unmade = |slot: &Slot<S>| !slot.ready.initialized() && Arc::strong_count(&slot.ready) == 1;
        if slots.by_run.get(run).is_some_and(unmade) {
            slots.by_run.remove(run);
        }
    }

    fn slots(&self) -> MutexGuard<'_, Slots<S>> {
        // Whole after every statement, so a panic elsewhere does not spoil it.
        self.slots.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn gone() -> Error {
    Error::cancelled("whoever asked for the scorer has gone")
}

fn stopping() -> Error {
    Error::unavailable("the server is stopping; try again")
}
