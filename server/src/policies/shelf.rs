//! Which policies are in memory, under which names, and which has to go when there are too many.

use std::{
    collections::HashMap,
    sync::{Arc, Weak},
};

use super::{engine::Engine, model::Model};
use crate::{
    domain::id::PolicyId,
    error::{Error, Result},
};

/// What is loaded. Names hold their policy until the memory is needed; a policy that no name holds lives on while
/// sessions hold it.
pub(super) struct Shelf<M: Model> {
    /// Most bytes of checkpoints in memory, unless sessions hold more.
    budget: u64,
    names: HashMap<String, PolicyId>,
    loaded: HashMap<PolicyId, Loaded<M>>,
    /// Counts uses, to tell which was least recent.
    uses: u64,
    stopped: bool,
}

struct Loaded<M: Model> {
    engine: Weak<Engine<M>>,
    /// While a name points at it and nothing else needs its memory more.
    kept: Option<Arc<Engine<M>>>,
    bytes: u64,
    /// Which use was its last.
    used: u64,
}

impl<M: Model> Loaded<M> {
    /// Whether nobody but the shelf holds it. Only with the shelf locked, so that nobody takes it meanwhile.
    fn is_idle(&self) -> bool {
        self.kept.as_ref().is_some_and(|engine| Arc::strong_count(engine) == 1)
    }
}

impl<M: Model> Shelf<M> {
    pub(super) fn new(budget: u64) -> Self {
        Self { budget, names: HashMap::new(), loaded: HashMap::new(), uses: 0, stopped: false }
    }

    /// The policy that a name points at, if it is loaded.
    pub(super) fn named(&mut self, name: &str) -> Option<Arc<Engine<M>>> {
        let id = self.names.get(name)?.clone();
        let engine = self.find(&id)?;
        self.keep(&id, &engine);
        Some(engine)
    }

    /// A policy, if it is loaded.
    ///
    /// # Errors
    /// Unavailable when nothing may be loaded any more.
    pub(super) fn loaded(&mut self, id: &PolicyId) -> Result<Option<Arc<Engine<M>>>> {
        if self.stopped {
            return Err(Error::unavailable("the server is stopping; try again"));
        }
        Ok(self.find(id))
    }

    /// A policy has been loaded from a checkpoint of this size. No name points at it yet.
    pub(super) fn put(&mut self, engine: &Arc<Engine<M>>, bytes: u64) {
        self.uses += 1;
        let loaded = Loaded { engine: Arc::downgrade(engine), kept: None, bytes, used: self.uses };
        self.loaded.insert(engine.identity().policy_id.clone(), loaded);
    }

    /// Points a name at a policy that is loaded. The one before goes when no other name or session holds it.
    pub(super) fn point(&mut self, name: &str, engine: &Arc<Engine<M>>) {
        let id = engine.identity().policy_id.clone();
        self.keep(&id, engine);
        if let Some(before) = self.names.insert(name.to_owned(), id)
            && !self.names.values().any(|named| *named == before)
            && let Some(loaded) = self.loaded.get_mut(&before)
        {
            loaded.kept = None;
        }
    }

    /// Unloads what was used least recently and nobody holds, until `coming` bytes more fit into the budget. When
    /// sessions hold too much for that, the budget is passed over rather than a session broken.
    pub(super) fn make_room(&mut self, coming: u64) {
        loop {
            self.loaded.retain(|_, loaded| loaded.engine.strong_count() > 0);
            let bytes: u64 = self.loaded.values().map(|loaded| loaded.bytes).sum();
            if bytes.saturating_add(coming) <= self.budget {
                return;
            }
            let idle = self.loaded.iter_mut().filter(|(_, loaded)| loaded.is_idle());
            let Some((id, oldest)) = idle.min_by_key(|(_, loaded)| loaded.used) else {
                if bytes > 0 {
                    tracing::warn!(bytes, coming, budget = self.budget, "policies in use pass over the memory budget");
                }
                return;
            };
            tracing::info!(policy.id = %id, "policy unloaded to make room");
            oldest.kept = None;
        }
    }

    /// Takes everything away; nothing may be loaded any more.
    pub(super) fn stop(&mut self) -> Vec<Arc<Engine<M>>> {
        self.stopped = true;
        self.names.clear();
        // What a name kept is taken before its engine is let go of.
        self.loaded.drain().filter_map(|(_, loaded)| loaded.engine.upgrade()).collect()
    }

    /// Whether a policy is in memory; asking is no use of it.
    #[cfg(test)]
    pub(super) fn has(&self, id: &PolicyId) -> bool {
        self.loaded.get(id).is_some_and(|loaded| loaded.engine.strong_count() > 0)
    }

    fn find(&mut self, id: &PolicyId) -> Option<Arc<Engine<M>>> {
        let loaded = self.loaded.get_mut(id)?;
        self.uses += 1;
        loaded.used = self.uses;
        loaded.engine.upgrade()
    }

    fn keep(&mut self, id: &PolicyId, engine: &Arc<Engine<M>>) {
        if let Some(loaded) = self.loaded.get_mut(id) {
            loaded.kept = Some(Arc::clone(engine));
        }
    }
}

#[cfg(test)]
mod tests;
