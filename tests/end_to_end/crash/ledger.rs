//! What was asked of the server, and what of it was acknowledged. An episode's state is one of those that were asked
//! for since the last one that was acknowledged, that one included.

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Mutex,
};

use gleaner_proto::v1::{Episode, Job, JobState, Outcome};
use tokio::sync::watch;

/// How an episode looks from outside.
#[derive(Clone, Debug, PartialEq)]
pub struct State {
    pub outcome: Outcome,
    pub cohort: String,
    pub deleted: bool,
}

/// An episode whose upload was acknowledged.
#[derive(Clone, Debug)]
pub struct Kept {
    pub blake3: String,
    /// Every state that was asked for, in order.
    pub asked: Vec<State>,
    /// Which of them was acknowledged last.
    pub told: usize,
}

/// All that is acknowledged.
#[derive(Clone, Debug, Default)]
pub struct Book {
    pub episodes: BTreeMap<String, Kept>,
    /// Contents that an upload was begun of.
    pub attempted: BTreeSet<String>,
    /// Contents that are no recordings.
    pub garbage: BTreeSet<String>,
    /// Jobs, and how they ended if they have.
    pub jobs: BTreeMap<String, Option<JobState>>,
    pub datasets: BTreeSet<String>,
    pub snapshots: BTreeSet<String>,
    pub policies: Vec<String>,
    /// Names, with the policies that were asked for and which was acknowledged last.
    pub deployments: BTreeMap<String, (Vec<String>, usize)>,
    /// Episodes of sessions that were closed.
    pub rollouts: BTreeSet<String>,
}

/// The book, and how much was ever written into it.
#[derive(Debug)]
pub struct Ledger {
    book: Mutex<Book>,
    acknowledged: watch::Sender<u64>,
}

impl Default for Ledger {
    fn default() -> Self {
        Self { book: Mutex::default(), acknowledged: watch::Sender::new(0) }
    }
}

impl Ledger {
    /// As it is now.
    pub fn read(&self) -> Book {
        self.book.lock().unwrap().clone()
    }

    /// How many things were acknowledged, as it grows.
    pub fn acknowledged(&self) -> watch::Receiver<u64> {
        self.acknowledged.subscribe()
    }

    pub fn attempts(&self, blake3: &str) {
        self.book.lock().unwrap().attempted.insert(blake3.to_owned());
    }

    pub fn spoils(&self, blake3: String) {
        self.book.lock().unwrap().garbage.insert(blake3);
    }

    pub fn stored(&self, episode: &Episode) {
        let state = state(episode);
        self.acknowledge(|book| {
            let kept = Kept { blake3: episode.blake3.clone(), asked: vec![state], told: 0 };
            book.episodes.entry(episode.id.clone()).or_insert(kept);
        });
    }

    /// Another state is about to be asked for.
    pub fn asks(&self, id: &str, state: State) {
        self.book.lock().unwrap().episodes.get_mut(id).unwrap().asked.push(state);
    }

    /// The state that was asked for last is acknowledged.
    pub fn told(&self, id: &str) {
        self.acknowledge(|book| {
            let kept = book.episodes.get_mut(id).unwrap();
            kept.told = kept.asked.len() - 1;
        });
    }

    pub fn job(&self, job: &Job) {
        self.acknowledge(|book| {
            let ended = gleaner_client::has_ended(job.state()).then(|| job.state());
            book.jobs.insert(job.id.clone(), ended);
        });
    }

    pub fn made_policy(&self, id: String) {
        self.acknowledge(|book| book.policies.push(id));
    }

    pub fn dataset(&self, id: String) {
        self.acknowledge(|book| {
            book.datasets.insert(id);
        });
    }

    pub fn snapshot(&self, id: String) {
        self.acknowledge(|book| {
            book.snapshots.insert(id);
        });
    }

    pub fn rollout(&self, id: String) {
        self.acknowledge(|book| {
            book.rollouts.insert(id);
        });
    }

    pub fn deploys(&self, name: &str, policy: &str) {
        let mut book = self.book.lock().unwrap();
        book.deployments.entry(name.to_owned()).or_default().0.push(policy.to_owned());
    }

    pub fn deployed(&self, name: &str) {
        self.acknowledge(|book| {
            let (asked, told) = book.deployments.get_mut(name).unwrap();
            *told = asked.len();
        });
    }

    pub fn summary(&self) -> String {
        let book = self.read();
        let changes: usize = book.episodes.values().map(|kept| kept.asked.len() - 1).sum();
        format!(
            "{} uploads, {changes} labels and deletes, {} jobs, {} snapshots, {} datasets, {} recorded sessions were \
             acknowledged, and are there",
            book.episodes.len(),
            book.jobs.len(),
            book.snapshots.len(),
            book.datasets.len(),
            book.rollouts.len()
        )
    }

    fn acknowledge(&self, write: impl FnOnce(&mut Book)) {
        write(&mut self.book.lock().unwrap());
        self.acknowledged.send_modify(|count| *count += 1);
    }
}

/// How the server lists an episode.
pub fn state(episode: &Episode) -> State {
    State { outcome: episode.outcome(), cohort: episode.cohort.clone(), deleted: false }
}
