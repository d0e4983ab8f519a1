//! Policies for clients that send one observation per request: alone, or as a sequence whose history the server keeps.
//!
//! A request that fails or is cancelled leaves its sequence unchanged. Must not depend on wire types.

use std::{
    collections::HashMap,
    sync::{Arc, Mutex, Weak},
    time::Duration,
};

use gleaner_learn::{Policy as LearnedPolicy, TaskShape};
use tokio::time::Instant;

use super::{
    Policies,
    engine::Engine,
    lock::lock,
    model::{Begin, Model, ModelInput},
    observation,
};
use crate::{
    domain::{
        id::PolicyId,
        observation::Observation,
        sequence::{Place, SequenceId},
    },
    error::{Error, Result},
};

/// The most sequences per deployment: more robots than one policy can serve in time. Each keeps only its window's
/// embeddings, so a full table takes a few megabytes.
const MOST: usize = 256;
/// A sequence without a request for this long is removed. Long enough for a person to reset a robot's scene.
const IDLE: Duration = Duration::from_secs(300);
/// The interval of the removal of idle sequences.
const SWEEP: Duration = Duration::from_secs(30);

/// A deployment's name and the client's id of the sequence.
type Key = (String, SequenceId);

/// All sequences; clones share them.
pub(super) struct Sequences<M: Model>(Arc<Mutex<Table<M>>>);

struct Table<M: Model> {
    slots: HashMap<Key, Arc<Slot<M>>>,
    /// Whether a task removes idle sequences; the task ends with the last sequence.
    swept: bool,
}

/// One sequence. A request holds its slot while it runs, so a slot held only by the table is idle.
struct Slot<M: Model> {
    engine: Arc<Engine<M>>,
    /// When the last request was answered.
    used: Mutex<Instant>,
    /// Locked during a request, so that requests are answered one after the other; `None` once the sequence is over.
    memory: tokio::sync::Mutex<Option<Memory<M::History>>>,
}

struct Memory<H> {
    history: H,
    /// The policy's last action: taken as executed unless the client sends another.
    given: Option<Vec<f32>>,
}

/// A policy for one request, with the history of its sequence.
pub(crate) struct Endpoint(SequenceCall<LearnedPolicy>);

/// An endpoint for any model.
struct SequenceCall<M: Model> {
    engine: Arc<Engine<M>>,
    place: Option<(Key, Place)>,
    /// `None` for a sequence that begins with this request.
    slot: Option<Arc<Slot<M>>>,
    sequences: Sequences<M>,
}

impl Policies {
    /// The policy for a request: a running sequence's own, otherwise the one the deployment points at.
    ///
    /// # Errors
    /// NotFound when there is no such deployment or its policy is not `version`; Invalid when the sequence is unknown
    /// and does not begin here.
    pub(crate) async fn endpoint(
        &self,
        deployment: &str,
        version: Option<&PolicyId>,
        place: Option<Place>,
    ) -> Result<Endpoint> {
        let sequences = &self.0.sequences;
        let call = match place {
            Some(place) if !place.start => sequences.running(deployment, place)?,
            starting => sequences.fresh(deployment, self.deployed(deployment).await?, starting),
        };
        let found = &call.engine.identity().policy_id;
        match version {
            Some(version) if version != found => {
                Err(Error::not_found("version", format!("{version} of {deployment}; it is {found}")))
            }
            _ => Ok(Endpoint(call)),
        }
    }
}

impl Endpoint {
    pub(crate) fn policy_id(&self) -> &PolicyId {
        &self.0.engine.identity().policy_id
    }

    pub(crate) fn shape(&self) -> Arc<TaskShape> {
        self.0.engine.shape()
    }

    /// Actions for an observation, in physical units, one per control period.
    ///
    /// # Errors
    /// Invalid, naming the field from `path` on; Exhausted when the queue is full, or every sequence is busy.
    pub(crate) async fn act(self, path: &'static str, observation: Observation) -> Result<Vec<Vec<f32>>> {
        self.0.act(path, observation).await
    }
}

impl<M: Model> SequenceCall<M>
where
    M::History: Clone,
{
    async fn act(self, path: &'static str, observation: Observation) -> Result<Vec<Vec<f32>>> {
        let shape = self.engine.shape();
        let mut step = observation::step_of(shape, path, observation).await?;
        let Some((key, place)) = self.place else {
            step.executed = None;
            let input = ModelInput { history: None, begin: Begin::default(), skipped: 0, steps: vec![step] };
            return Ok(self.engine.try_infer(input).await?.actions);
        };
        let slot = self.slot.unwrap_or_else(|| Slot::new(Arc::clone(&self.engine)));
        let mut memory = slot.memory.lock().await;
        if memory.is_none() && !place.start {
            return Err(unknown(&place.id));
        }
        // The first step of a history has no executed action before it.
        step.executed = memory.as_ref().and_then(|memory| step.executed.or_else(|| memory.given.clone()));
        let history = memory.as_ref().map(|memory| memory.history.clone());
        // Waits for a place in the queue, as sessions do: a sequence has one request in flight, and the number of
        // sequences is limited.
        // A client executes as many actions of each answer as it likes, and does not send how many.
        let begin = Begin { seed: place.id.seed(), new_chunks: true };
        let input = ModelInput { history, begin, skipped: 0, steps: vec![step] };
        let advanced = self.engine.infer(input).await?;
        if place.end {
            *memory = None;
            drop(memory);
            self.sequences.remove(&key, &slot, place.start);
            return Ok(advanced.actions);
        }
        *memory = Some(Memory { history: advanced.history, given: advanced.actions.first().cloned() });
        drop(memory);
        *lock(&slot.used) = Instant::now();
        if place.start {
            self.sequences.keep(key, slot)?;
        }
        Ok(advanced.actions)
    }
}

impl<M: Model> Slot<M> {
    fn new(engine: Arc<Engine<M>>) -> Arc<Self> {
        Arc::new(Self { engine, used: Mutex::new(Instant::now()), memory: tokio::sync::Mutex::new(None) })
    }
}

impl<M: Model> Sequences<M> {
    /// A request without history: alone, or the first of its sequence.
    fn fresh(&self, deployment: &str, engine: Arc<Engine<M>>, place: Option<Place>) -> SequenceCall<M> {
        let place = place.map(|place| ((deployment.to_owned(), place.id.clone()), place));
        SequenceCall { engine, place, slot: None, sequences: self.clone() }
    }

    /// A request that continues its sequence.
    fn running(&self, deployment: &str, place: Place) -> Result<SequenceCall<M>> {
        let key = (deployment.to_owned(), place.id.clone());
        let mut table = lock(&self.0);
        table.forget_idle();
        let slot = table.slots.get(&key).cloned().ok_or_else(|| unknown(&place.id))?;
        let engine = Arc::clone(&slot.engine);
        Ok(SequenceCall { engine, place: Some((key, place)), slot: Some(slot), sequences: self.clone() })
    }

    /// Keeps a new sequence. It replaces one of the same name, or else the one that has been idle longest.
    fn keep(&self, key: Key, slot: Arc<Slot<M>>) -> Result<()> {
        let mut table = lock(&self.0);
        table.forget_idle();
        if !table.slots.contains_key(&key) {
            table.make_room(&key.0)?;
        }
        table.slots.insert(key, slot);
        if !std::mem::replace(&mut table.swept, true) {
            tokio::spawn(sweep(Arc::downgrade(&self.0)));
        }
        Ok(())
    }

    /// Removes a sequence that is over. `whichever`: also an older one of the same name.
    fn remove(&self, key: &Key, slot: &Arc<Slot<M>>, whichever: bool) {
        let mut table = lock(&self.0);
        if table.slots.get(key).is_some_and(|kept| whichever || Arc::ptr_eq(kept, slot)) {
            table.slots.remove(key);
        }
    }
}

impl<M: Model> Table<M> {
    fn forget_idle(&mut self) {
        self.slots.retain(|_, slot| !slot.is_idle() || lock(&slot.used).elapsed() < IDLE);
    }

    fn make_room(&mut self, deployment: &str) -> Result<()> {
        let own = || self.slots.iter().filter(|(key, _)| key.0 == deployment);
        if own().count() < MOST {
            return Ok(());
        }
        let oldest = own().filter(|(_, slot)| slot.is_idle()).min_by_key(|(_, slot)| *lock(&slot.used));
        let Some((oldest, _)) = oldest else {
            return Err(Error::exhausted(format!(
                "all {MOST} sequences of {deployment} are busy; end some with sequence_end, or retry later"
            )));
        };
        let oldest = oldest.clone();
        tracing::info!(deployment.name = deployment, sequence.id = %oldest.1, "the longest idle sequence was removed");
        self.slots.remove(&oldest);
        Ok(())
    }
}

impl<M: Model> Slot<M> {
    /// Requires the table's lock, so that the count cannot rise meanwhile.
    fn is_idle(self: &Arc<Self>) -> bool {
        Arc::strong_count(self) == 1
    }
}

impl<M: Model> Clone for Sequences<M> {
    fn clone(&self) -> Self {
        Self(Arc::clone(&self.0))
    }
}

impl<M: Model> Default for Sequences<M> {
    fn default() -> Self {
        Self(Arc::new(Mutex::new(Table { slots: HashMap::new(), swept: false })))
    }
}

/// Removes idle sequences, which keep their policies in memory, until the last one is removed.
async fn sweep<M: Model>(table: Weak<Mutex<Table<M>>>) {
    loop {
        tokio::time::sleep(SWEEP).await;
        let Some(table) = table.upgrade() else { return };
        let mut table = lock(&table);
        table.forget_idle();
        if table.slots.is_empty() {
            table.swept = false;
            return;
        }
    }
}

fn unknown(id: &SequenceId) -> Error {
    Error::invalid(
        "parameters.sequence_id",
        format!("unknown sequence {id}: it ended or was idle too long; begin it with sequence_start"),
    )
}

#[cfg(test)]
mod tests;
