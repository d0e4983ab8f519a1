//! A caller's hold of a loaded run. The run may be unloaded once its last hold is dropped.

use std::{
    ops::Deref,
    sync::{Arc, Weak},
};

use super::{Ready, loaded_runs::LoadedRuns, model::Scorer};

/// A held run.
pub(crate) struct Held<S: Scorer> {
    ready: Arc<Ready<S>>,
    /// Dropped after `ready`, because fields are dropped in order: the run is then idle if this was the last hold.
    _room: Room<S>,
}

impl<S: Scorer> Held<S> {
    pub(super) fn new(ready: Arc<Ready<S>>) -> Self {
        let room = Room(Weak::clone(&ready.loaded));
        Self { ready, _room: room }
    }
}

impl<S: Scorer> Deref for Held<S> {
    type Target = Ready<S>;

    fn deref(&self) -> &Ready<S> {
        &self.ready
    }
}

/// Unloads idle runs above the budget on drop.
struct Room<S: Scorer>(Weak<LoadedRuns<S>>);

impl<S: Scorer> Drop for Room<S> {
    fn drop(&mut self) {
        if let Some(loaded) = self.0.upgrade() {
            loaded.make_room();
        }
    }
}
