//! Policies for clients that ask one observation a request: alone, or as a sequence that the server remembers.
//!
//! A request that fails, or whose caller goes, leaves its sequence as it was. Knows no wire type.

use std::{
    collections::HashMap,
    sync::{Arc, Mutex, Weak},
    time::Duration,
};

use gleaner_learn::{Policy as LearnedPolicy, TaskShape};
use tokio::time::Instant;

use super::{
    Policies,
    engine::{Engine, lock},
    model::{Model, Turn},
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

/// Sequences of one deployment at once: more robots than one policy serves in time. Each keeps only its window's
/// embeddings, so a full table costs a few megabytes.
const MOST: usize = 256;
/// A sequence this long without a request is over: its client has gone without saying so. Long enough for a person
/// to put a robot's scene right.
const IDLE: Duration = Duration::from_secs(300);
/// How often idle ones are looked for.
const SWEEP: Duration = Duration::from_secs(30);

/// A deployment's name and what its client calls the sequence.
type Key = (String, SequenceId);

/// Every sequence that is remembered; clones share them.
pub(super) struct Sequences<M: Model>(Arc<Mutex<Table<M>>>);

struct Table<M: Model> {
    slots: HashMap<Key, Arc<Slot<M>>>,
    /// A task looks for idle sequences; it ends when there are none.
    swept: bool,
}

/// One sequence. A request holds its slot while it runs, so a slot that only the table holds is idle.
struct Slot<M: Model> {
    engine: Arc<Engine<M>>,
    /// When the last request was answered.
    used: Mutex<Instant>,
    /// Held during a turn, so that requests are answered one after the other; `None` once the sequence is over.
    memory: tokio::sync::Mutex<Option<Memory<M::History>>>,
}

struct Memory<H> {
    history: H,
    /// What the policy gave last: taken as executed unless the client says otherwise.
    given: Option<Vec<f32>>,
}

/// A policy that answers one request, and what it remembers for it.
pub(crate) struct Endpoint(Asked<LearnedPolicy>);

/// What an endpoint is, for any model.
struct Asked<M: Model> {
    engine: Arc<Engine<M>>,
    place: Option<(Key, Place)>,
    /// The sequence's, unless it begins here.
    slot: Option<Arc<Slot<M>>>,
    sequences: Sequences<M>,
}

impl Policies {
    /// The policy for a request: a running sequence's own, otherwise the one the deployment points at.
    ///
    /// # Errors
    /// NotFound when there is no such deployment or its policy is not `version`; Invalid when the sequence is not
    /// known and does not begin here.
    pub(crate) async fn endpoint(
        &self,
        deployment: &str,
        version: Option<&PolicyId>,
        place: Option<Place>,
    ) -> Result<Endpoint> {
        let sequences = &self.0.sequences;
        let asked = match place {
            Some(place) if !place.start => sequences.running(deployment, place)?,
            starting => sequences.fresh(deployment, self.deployed(deployment).await?, starting),
        };
        let found = &asked.engine.identity().policy_id;
        match version {
            Some(version) if version != found => {
                Err(Error::not_found("version", format!("{version} of {deployment}; it is {found}")))
            }
            _ => Ok(Endpoint(asked)),
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

    /// Actions for an observation, in physical units, one a control period.
    ///
    /// # Errors
    /// Invalid, naming the field from `path` on; Exhausted when too many wait, or every sequence is busy.
    pub(crate) async fn act(self, path: &'static str, observation: Observation) -> Result<Vec<Vec<f32>>> {
        self.0.act(path, observation).await
    }
}

impl<M: Model> Asked<M>
where
    M::History: Clone,
{
    async fn act(self, path: &'static str, observation: Observation) -> Result<Vec<Vec<f32>>> {
        let shape = self.engine.shape();
        let mut step = observation::step_of(shape, path, observation).await?;
        let Some((key, place)) = self.place else {
            step.executed = None;
            let turn = Turn { history: None, skipped: 0, steps: vec![step] };
            return Ok(self.engine.try_ask(turn).await?.actions);
        };
        let slot = self.slot.unwrap_or_else(|| Slot::new(Arc::clone(&self.engine)));
        let mut memory = slot.memory.lock().await;
        if memory.is_none() && !place.start {
            return Err(unknown(&place.id));
        }
        // The first step of a history has nothing before it.
        step.executed = memory.as_ref().and_then(|memory| step.executed.or_else(|| memory.given.clone()));
        let history = memory.as_ref().map(|memory| memory.history.clone());
        // Waits for its turn, as sessions do: a sequence asks once at a time, and there are only so many.
        let advanced = self.engine.ask(Turn { history, skipped: 0, steps: vec![step] }).await?;
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
    /// A request without history: on its own, or the first of its sequence.
    fn fresh(&self, deployment: &str, engine: Arc<Engine<M>>, place: Option<Place>) -> Asked<M> {
        let place = place.map(|place| ((deployment.to_owned(), place.id.clone()), place));
        Asked { engine, place, slot: None, sequences: self.clone() }
    }

    /// A request that goes on with its sequence.
    fn running(&self, deployment: &str, place: Place) -> Result<Asked<M>> {
        let key = (deployment.to_owned(), place.id.clone());
        let mut table = lock(&self.0);
        table.forget_idle();
        let slot = table.slots.get(&key).cloned().ok_or_else(|| unknown(&place.id))?;
        let engine = Arc::clone(&slot.engine);
        Ok(Asked { engine, place: Some((key, place)), slot: Some(slot), sequences: self.clone() })
    }

    /// Remembers a sequence that has begun. It takes the place of one of the same name, or of the longest idle.
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

    /// Forgets a sequence that is over. `whichever`: also an older one of the same name.
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
                "all {MOST} sequences of {deployment} are busy; end some with sequence_end, or try again later"
            )));
        };
        let oldest = oldest.clone();
        tracing::info!(deployment.name = deployment, sequence.id = %oldest.1, "forgot the longest idle sequence");
        self.slots.remove(&oldest);
        Ok(())
    }
}

impl<M: Model> Slot<M> {
    /// Only asked with the table locked, so that nobody takes it meanwhile.
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

/// Forgets idle sequences, which hold their policies in memory, until there are none.
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
        format!("no sequence {id} runs here: it ended, or was idle too long; begin it with sequence_start"),
    )
}

#[cfg(test)]
mod tests;
