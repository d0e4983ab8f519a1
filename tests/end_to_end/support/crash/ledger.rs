//! The changes that clients requested and the server acknowledged. An episode has the last acknowledged state or one that
//! was requested after it.

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Mutex,
};

use gleaner_proto::v1::{Episode, Job, JobState, Outcome};
use tokio::sync::watch;

/// The state of an episode that clients change.
#[derive(Clone, Debug, PartialEq)]
pub struct State {
    pub outcome: Outcome,
    pub cohort: String,
    pub deleted: bool,
}

/// An episode whose upload was acknowledged.
#[derive(Clone, Debug)]
pub struct Stored {
    pub blake3: String,
    /// Every requested state, in order.
    pub requested: Vec<State>,
    /// The index of the last acknowledged state.
    pub acknowledged: usize,
}

/// Everything that is acknowledged.
#[derive(Clone, Debug, Default)]
pub struct Acknowledged {
    pub episodes: BTreeMap<String, Stored>,
    /// Contents whose upload has started.
    pub attempted: BTreeSet<String>,
    /// Contents that are not recordings.
    pub garbage: BTreeSet<String>,
    /// Jobs, with their last state if they have ended.
    pub jobs: BTreeMap<String, Option<JobState>>,
    pub datasets: BTreeSet<String>,
    /// Imported score runs.
    pub imports: BTreeSet<String>,
    pub snapshots: BTreeSet<String>,
    pub policies: Vec<String>,
    /// Names, with the requested policies and how many of them are acknowledged.
    pub deployments: BTreeMap<String, (Vec<String>, usize)>,
    /// Episodes of sessions that were closed.
    pub rollouts: BTreeSet<String>,
}

/// The acknowledged changes and their number.
#[derive(Debug)]
pub struct Ledger {
    acknowledged: Mutex<Acknowledged>,
    count: watch::Sender<u64>,
}

impl Default for Ledger {
    fn default() -> Self {
        Self { acknowledged: Mutex::default(), count: watch::Sender::new(0) }
    }
}

impl Ledger {
    /// A copy of the acknowledged changes.
    pub fn read(&self) -> Acknowledged {
        self.acknowledged.lock().unwrap().clone()
    }

    /// The number of acknowledged changes, as it grows.
    pub fn count(&self) -> watch::Receiver<u64> {
        self.count.subscribe()
    }

    pub fn add_attempt(&self, blake3: &str) {
        self.acknowledged.lock().unwrap().attempted.insert(blake3.to_owned());
    }

    pub fn add_garbage(&self, blake3: String) {
        self.acknowledged.lock().unwrap().garbage.insert(blake3);
    }

    pub fn add_episode(&self, episode: &Episode) {
        let state = state(episode);
        self.acknowledge(|all| {
            let kept = Stored { blake3: episode.blake3.clone(), requested: vec![state], acknowledged: 0 };
            all.episodes.entry(episode.id.clone()).or_insert(kept);
        });
    }

    /// Adds a state that is about to be requested.
    pub fn request_state(&self, id: &str, state: State) {
        self.acknowledged.lock().unwrap().episodes.get_mut(id).unwrap().requested.push(state);
    }

    /// Marks the last requested state as acknowledged.
    pub fn acknowledge_state(&self, id: &str) {
        self.acknowledge(|all| {
            let kept = all.episodes.get_mut(id).unwrap();
            kept.acknowledged = kept.requested.len() - 1;
        });
    }

    pub fn add_job(&self, job: &Job) {
        self.acknowledge(|all| {
            let ended = gleaner_client::has_ended(job.state()).then(|| job.state());
            all.jobs.insert(job.id.clone(), ended);
        });
    }

    pub fn add_policy(&self, id: String) {
        self.acknowledge(|all| all.policies.push(id));
    }

    pub fn add_import(&self, id: String) {
        self.acknowledge(|all| {
            all.imports.insert(id);
        });
    }

    pub fn add_dataset(&self, id: String) {
        self.acknowledge(|all| {
            all.datasets.insert(id);
        });
    }

    pub fn add_snapshot(&self, id: String) {
        self.acknowledge(|all| {
            all.snapshots.insert(id);
        });
    }

    pub fn add_rollout(&self, id: String) {
        self.acknowledge(|all| {
            all.rollouts.insert(id);
        });
    }

    pub fn request_deployment(&self, name: &str, policy: &str) {
        let mut all = self.acknowledged.lock().unwrap();
        all.deployments.entry(name.to_owned()).or_default().0.push(policy.to_owned());
    }

    pub fn acknowledge_deployment(&self, name: &str) {
        self.acknowledge(|all| {
            let (requested, acknowledged) = all.deployments.get_mut(name).unwrap();
            *acknowledged = requested.len();
        });
    }

    pub fn summary(&self) -> String {
        let all = self.read();
        let changes: usize = all.episodes.values().map(|kept| kept.requested.len() - 1).sum();
        format!(
            "{} uploads, {changes} labels and deletes, {} jobs, {} snapshots, {} datasets, {} recorded sessions were \
             acknowledged, and are there",
            all.episodes.len(),
            all.jobs.len(),
            all.snapshots.len(),
            all.datasets.len(),
            all.rollouts.len()
        )
    }

    fn acknowledge(&self, write: impl FnOnce(&mut Acknowledged)) {
        write(&mut self.acknowledged.lock().unwrap());
        self.count.send_modify(|count| *count += 1);
    }
}

/// The state of an episode as the server lists it.
pub fn state(episode: &Episode) -> State {
    State { outcome: episode.outcome(), cohort: episode.cohort.clone(), deleted: false }
}
