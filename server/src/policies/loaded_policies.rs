//! Loaded policies and the deployment names that point at them.

use std::{collections::HashMap, sync::Arc};

use super::{engine::Engine, model::Model};
use crate::{domain::id::PolicyId, error::Result, model_cache::ModelCache};

/// A policy, and whether its history is hidden: two models for the callers.
pub(super) type Key = (PolicyId, bool);

/// Policies in memory. A name pins its policy; a policy without a name lives on while sessions hold it.
pub(super) struct LoadedPolicies<M: Model> {
    names: HashMap<String, Key>,
    /// Weighed by the bytes of their checkpoints.
    engines: ModelCache<Key, Engine<M>>,
}

impl<M: Model> LoadedPolicies<M> {
    /// `budget`: the most bytes of checkpoints in memory, unless policies in use exceed it.
    pub(super) fn new(budget: u64) -> Self {
        Self { names: HashMap::new(), engines: ModelCache::new(budget) }
    }

    /// The policy that a name points at, if it is loaded.
    pub(super) fn named(&mut self, name: &str) -> Option<Arc<Engine<M>>> {
        let id = self.names.get(name)?.clone();
        let engine = self.engines.get(&id).ok().flatten()?;
        self.engines.pin(&id, &engine);
        Some(engine)
    }

    /// Every name with the policy that it points at.
    pub(super) fn names(&self) -> Vec<(String, Key)> {
        self.names.iter().map(|(name, key)| (name.clone(), key.clone())).collect()
    }

    /// A policy, if it is loaded.
    ///
    /// # Errors
    /// Unavailable after [`Self::stop`].
    pub(super) fn loaded(&mut self, key: &Key) -> Result<Option<Arc<Engine<M>>>> {
        self.engines.get(key)
    }

    /// Adds a policy that was loaded from a checkpoint of this size. No name points at it yet.
    pub(super) fn put(&mut self, engine: &Arc<Engine<M>>, bytes: u64) {
        self.engines.insert(engine.identity().key(), engine, bytes);
    }

    /// Points a name at a loaded policy. The policy before is unpinned unless another name points at it.
    pub(super) fn point(&mut self, name: &str, engine: &Arc<Engine<M>>) {
        let id = engine.identity().key();
        self.engines.pin(&id, engine);
        let before = self.names.insert(name.to_owned(), id);
        self.unpin(before);
    }

    /// Removes a name. Its policy is unpinned unless another name points at it.
    pub(super) fn forget(&mut self, name: &str) {
        let before = self.names.remove(name);
        self.unpin(before);
    }

    fn unpin(&mut self, before: Option<Key>) {
        if let Some(before) = before
            && !self.names.values().any(|named| *named == before)
        {
            self.engines.unpin(&before);
        }
    }

    /// Unloads idle policies, the least recently used first, until `coming` bytes more fit into the budget. Policies in
    /// use may exceed the budget: no session is closed for it.
    pub(super) fn make_room(&mut self, coming: u64) {
        for ((id, _), _engine) in self.engines.make_room(coming) {
            tracing::info!(policy.id = %id, "policy unloaded to make room");
        }
        let bytes = self.engines.weight();
        if bytes > 0 && !self.engines.has_room(coming) {
            tracing::warn!(bytes, coming, "policies in use exceed --policy-memory-bytes");
        }
    }

    /// Removes and returns every policy; later requests are refused.
    pub(super) fn stop(&mut self) -> Vec<Arc<Engine<M>>> {
        self.names.clear();
        self.engines.stop()
    }

    /// Whether a policy is in memory; this counts as no use.
    #[cfg(test)]
    pub(super) fn has(&self, id: &PolicyId) -> bool {
        self.engines.keys().iter().any(|(loaded, _)| loaded == id)
    }
}

#[cfg(test)]
mod tests;
