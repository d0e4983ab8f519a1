//! Models in memory under a budget: the least recently used is evicted first, models in use never.
//!
//! `policies` and `scorers` share this eviction rule and add their own parts: names that point at a policy, and loads
//! that several callers wait for. The cache is used with its owner's lock held, so that the count of a model's holders
//! cannot rise during the check.

use std::{
    collections::HashMap,
    hash::Hash,
    sync::{Arc, Weak},
};

use crate::error::{Error, Result};

/// Loaded models by key. A pinned model stays in memory until the budget needs its space; an unpinned one lives as long
/// as its other holders.
#[derive(Debug)]
pub(crate) struct ModelCache<K, M> {
    /// The largest sum of weights, unless models in use exceed it.
    budget: u64,
    entries: HashMap<K, Entry<M>>,
    /// Counter of uses, which orders entries by their last one.
    uses: u64,
    stopped: bool,
}

#[derive(Debug)]
struct Entry<M> {
    model: Weak<M>,
    pinned: Option<Arc<M>>,
    weight: u64,
    /// The number of the last use.
    used: u64,
}

impl<M> Entry<M> {
    fn is_loaded(&self) -> bool {
        self.model.strong_count() > 0
    }

    /// Whether the cache is the only holder.
    fn is_idle(&self) -> bool {
        self.pinned.as_ref().is_some_and(|model| Arc::strong_count(model) == 1)
    }
}

impl<K: Clone + Eq + Hash, M> ModelCache<K, M> {
    pub(crate) fn new(budget: u64) -> Self {
        Self { budget, entries: HashMap::new(), uses: 0, stopped: false }
    }

    /// Returns a loaded model; this counts as a use.
    ///
    /// # Errors
    /// Unavailable after [`Self::stop`].
    pub(crate) fn get(&mut self, key: &K) -> Result<Option<Arc<M>>> {
        if self.stopped {
            return Err(Error::unavailable("the server is stopping; retry"));
        }
        let Some(entry) = self.entries.get_mut(key) else { return Ok(None) };
        self.uses += 1;
        entry.used = self.uses;
        Ok(entry.model.upgrade())
    }

    /// Adds a loaded model, unpinned.
    pub(crate) fn insert(&mut self, key: K, model: &Arc<M>, weight: u64) {
        self.uses += 1;
        self.entries.insert(key, Entry { model: Arc::downgrade(model), pinned: None, weight, used: self.uses });
    }

    /// Keeps a model in memory without other holders.
    pub(crate) fn pin(&mut self, key: &K, model: &Arc<M>) {
        if let Some(entry) = self.entries.get_mut(key) {
            entry.pinned = Some(Arc::clone(model));
        }
    }

    /// Leaves a model to its other holders.
    pub(crate) fn unpin(&mut self, key: &K) {
        if let Some(entry) = self.entries.get_mut(key) {
            entry.pinned = None;
        }
    }

    /// Removes idle models, the least recently used first, until `coming` more fits into the budget or none is idle.
    /// Returns the removed models, to be dropped outside the owner's lock.
    pub(crate) fn make_room(&mut self, coming: u64) -> Vec<(K, Arc<M>)> {
        let mut removed = Vec::new();
        self.entries.retain(|_, entry| entry.is_loaded());
        while self.weight().saturating_add(coming) > self.budget {
            let idle = self.entries.iter().filter(|(_, entry)| entry.is_idle());
            let Some(key) = idle.min_by_key(|(_, entry)| entry.used).map(|(key, _)| key.clone()) else { break };
            let pinned = self.entries.remove(&key).and_then(|entry| entry.pinned);
            removed.extend(pinned.map(|model| (key, model)));
        }
        removed
    }

    /// Whether `coming` more fits into the budget.
    pub(crate) fn has_room(&self, coming: u64) -> bool {
        self.weight().saturating_add(coming) <= self.budget
    }

    /// The sum of the weights of all loaded models.
    pub(crate) fn weight(&self) -> u64 {
        self.entries.values().filter(|entry| entry.is_loaded()).map(|entry| entry.weight).sum()
    }

    /// Whether [`Self::stop`] was called.
    pub(crate) fn is_stopped(&self) -> bool {
        self.stopped
    }

    /// Removes and returns every loaded model, and rejects later requests.
    pub(crate) fn stop(&mut self) -> Vec<Arc<M>> {
        self.stopped = true;
        // Upgraded before the entry's own reference is dropped.
        self.entries.drain().filter_map(|(_, entry)| entry.model.upgrade()).collect()
    }

    /// The keys of all loaded models; this does not count as a use.
    #[cfg(test)]
    pub(crate) fn keys(&self) -> Vec<K> {
        self.entries.iter().filter(|(_, entry)| entry.is_loaded()).map(|(key, _)| key.clone()).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::Kind;

    /// Inserts and pins a model of weight 10.
    fn load(cache: &mut ModelCache<char, char>, key: char) -> Arc<char> {
        let model = Arc::new(key);
        cache.insert(key, &model, 10);
        cache.pin(&key, &model);
        model
    }

    fn removed(cache: &mut ModelCache<char, char>, coming: u64) -> String {
        cache.make_room(coming).into_iter().map(|(key, _)| key).collect()
    }

    #[test]
    fn the_least_recently_used_idle_model_is_removed_first() {
        let mut cache = ModelCache::new(20);
        for key in ['a', 'b'] {
            load(&mut cache, key);
        }
        assert!(cache.get(&'a').unwrap().is_some());
        assert_eq!(removed(&mut cache, 0), "");
        assert_eq!(removed(&mut cache, 10), "b");
        assert_eq!(removed(&mut cache, 30), "a", "more than the budget removes all idle models");
    }

    #[test]
    fn a_model_in_use_is_not_removed_until_its_last_holder_drops_it() {
        let mut cache = ModelCache::new(0);
        let model = load(&mut cache, 'a');
        assert_eq!(removed(&mut cache, 0), "");
        assert!(!cache.has_room(0));
        let other = Arc::clone(&model);
        drop(model);
        assert_eq!(removed(&mut cache, 0), "", "another holder is left");
        drop(other);
        assert_eq!(removed(&mut cache, 0), "a");
    }

    #[test]
    fn an_unpinned_model_lives_as_long_as_its_holders() {
        let mut cache = ModelCache::new(20);
        let model = load(&mut cache, 'a');
        cache.unpin(&'a');
        assert!(cache.get(&'a').unwrap().is_some() && cache.weight() == 10);
        drop(model);
        assert!(cache.get(&'a').unwrap().is_none() && cache.weight() == 0);
    }

    #[test]
    fn a_stopped_cache_returns_its_models_and_refuses_requests() {
        let mut cache = ModelCache::new(20);
        load(&mut cache, 'a');
        assert_eq!(cache.stop().len(), 1);
        assert!(cache.is_stopped());
        assert_eq!(cache.get(&'a').unwrap_err().kind(), Kind::Unavailable);
    }
}
