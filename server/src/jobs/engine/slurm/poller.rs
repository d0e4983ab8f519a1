//! One squeue for all open attempts, at an interval, and none while no attempt is open.

use std::{
    collections::HashMap,
    sync::{
        Arc,
        atomic::{AtomicUsize, Ordering},
    },
    time::Duration,
};

use tokio::{
    sync::{Notify, watch},
    time::Instant,
};
use tokio_util::task::AbortOnDropHandle;

use super::{commands::Commands, commands::Entry, state::State};

/// Shortest interval between two calls of squeue.
#[cfg(not(test))]
const SHORTEST: Duration = Duration::from_millis(200);
#[cfg(test)]
const SHORTEST: Duration = Duration::from_millis(5);

/// The last answers of squeue.
#[derive(Debug, Clone, Default)]
pub(super) struct Snapshot {
    /// When the last call that succeeded began; `None` before the first.
    asked_at: Option<Instant>,
    /// Its answer.
    entries: Arc<HashMap<String, Vec<Entry>>>,
    /// The reason for which the last call failed; `None` if it succeeded.
    pub(super) problem: Option<String>,
}

impl Snapshot {
    /// The job of this name: of several, one that has not ended.
    pub(super) fn entry(&self, name: &str) -> Option<&Entry> {
        let entries = self.entries.get(name)?;
        entries.iter().find(|entry| !State::of(entry).over()).or(entries.last())
    }

    /// The ids of the jobs of this name that have not ended.
    pub(super) fn alive(&self, name: &str) -> Vec<String> {
        let entries = self.entries.get(name).into_iter().flatten();
        entries.filter(|entry| !State::of(entry).over()).map(|entry| entry.id.clone()).collect()
    }
}

/// The poller; clones share it.
#[derive(Clone)]
pub(super) struct Poller(Arc<Inner>);

struct Inner {
    shared: Arc<Shared>,
    _polling: AbortOnDropHandle<()>,
}

struct Shared {
    commands: Commands,
    interval: Duration,
    snapshots: watch::Sender<Snapshot>,
    open: AtomicUsize,
    wake: Notify,
}

impl Poller {
    pub(super) fn start(commands: Commands, interval: Duration) -> Self {
        let shared = Arc::new(Shared {
            commands,
            interval,
            snapshots: watch::Sender::default(),
            open: AtomicUsize::new(0),
            wake: Notify::new(),
        });
        let polling = AbortOnDropHandle::new(tokio::spawn(poll(Arc::clone(&shared))));
        Self(Arc::new(Inner { shared, _polling: polling }))
    }

    /// Calls squeue without the rest of the interval.
    pub(super) fn hurry(&self) {
        self.0.shared.wake.notify_one();
    }

    /// Polls for as long as the view exists.
    pub(super) fn view(&self) -> View {
        let shared = Arc::clone(&self.0.shared);
        shared.open.fetch_add(1, Ordering::Relaxed);
        shared.wake.notify_one();
        View { snapshots: shared.snapshots.subscribe(), shared }
    }
}

/// An open attempt's view of the queue.
pub(super) struct View {
    snapshots: watch::Receiver<Snapshot>,
    shared: Arc<Shared>,
}

impl View {
    /// Waits for an answer to a call that began after `since`; `problem` receives the reasons of failed calls.
    pub(super) async fn after(&mut self, since: Instant, mut problem: impl FnMut(&str)) -> (Instant, Snapshot) {
        loop {
            let snapshot = self.snapshots.borrow_and_update().clone();
            match snapshot.asked_at {
                Some(asked_at) if asked_at > since => return (asked_at, snapshot),
                Some(_) | None => snapshot.problem.as_deref().into_iter().for_each(&mut problem),
            }
            if self.snapshots.changed().await.is_err() {
                // The poller ends with the server only.
                std::future::pending::<()>().await;
            }
        }
    }
}

impl Drop for View {
    fn drop(&mut self) {
        self.shared.open.fetch_sub(1, Ordering::Relaxed);
    }
}

async fn poll(shared: Arc<Shared>) {
    loop {
        while shared.open.load(Ordering::Relaxed) == 0 {
            shared.wake.notified().await;
        }
        let asked_at = Instant::now();
        match shared.commands.list().await {
            Ok(list) => {
                let mut entries: HashMap<String, Vec<Entry>> = HashMap::new();
                for entry in list {
                    entries.entry(entry.name.clone()).or_default().push(entry);
                }
                let entries = Arc::new(entries);
                shared.snapshots.send_replace(Snapshot { asked_at: Some(asked_at), entries, problem: None });
            }
            Err(problem) => {
                let problem = problem.to_string();
                tracing::warn!(problem, "the queue of Slurm cannot be read; retrying");
                shared.snapshots.send_modify(|snapshot| snapshot.problem = Some(problem));
            }
        }
        tokio::time::sleep(SHORTEST).await;
        // The cause of the wake-up does not matter.
        let _ = tokio::time::timeout(shared.interval, shared.wake.notified()).await;
    }
}
