//! One squeue for all open attempts, at an interval, and none while no attempt is open.

use std::{
    collections::{HashMap, HashSet},
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

use super::{
    commands::{Commands, Entry, Listing, not_a_job},
    state::State,
};

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
    /// Its lines that are not jobs.
    malformed: Arc<[String]>,
    /// The reason for which the last call failed; `None` if it succeeded.
    pub(super) problem: Option<String>,
}

impl Snapshot {
    /// The job of this name: of several, one that has not ended.
    pub(super) fn entry(&self, name: &str) -> Option<&Entry> {
        let entries = self.entries.get(name)?;
        entries.iter().find(|entry| !State::of(entry).over()).or(entries.last())
    }

    /// The malformed line for which the answer is no statement about the job of this name: it has the name, or it has no
    /// fields, as the words of a command that failed half-way have none, and the job is not listed. `None` if the answer
    /// is a statement.
    fn unreadable(&self, name: &str) -> Option<&str> {
        let entry = self.entry(name);
        if entry.is_some_and(|entry| !State::of(entry).over()) {
            return None;
        }
        let hides = |line: &&String| line.contains(name) || (entry.is_none() && !line.contains('|'));
        self.malformed.iter().find(hides).map(String::as_str)
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

    /// Polls for as long as the view of the job of this name exists.
    pub(super) fn view(&self, name: &str) -> View {
        let shared = Arc::clone(&self.0.shared);
        shared.open.fetch_add(1, Ordering::Relaxed);
        shared.wake.notify_one();
        View { name: name.to_owned(), snapshots: shared.snapshots.subscribe(), shared }
    }
}

/// An open attempt's view of the queue.
pub(super) struct View {
    name: String,
    snapshots: watch::Receiver<Snapshot>,
    shared: Arc<Shared>,
}

impl View {
    /// Waits for an answer to a call that began after `since` and that is a statement about the job; `problem` receives
    /// the reasons of the others.
    pub(super) async fn after(&mut self, since: Instant, mut problem: impl FnMut(&str)) -> (Instant, Snapshot) {
        loop {
            let snapshot = self.snapshots.borrow_and_update().clone();
            match snapshot.asked_at {
                Some(asked_at) if asked_at > since => match snapshot.unreadable(&self.name) {
                    Some(line) => problem(&not_a_job(line)),
                    None => return (asked_at, snapshot),
                },
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
    let mut logged = HashSet::new();
    loop {
        while shared.open.load(Ordering::Relaxed) == 0 {
            shared.wake.notified().await;
        }
        let asked_at = Instant::now();
        match shared.commands.list().await {
            Ok(Listing { entries: list, malformed }) => {
                if let [first, ..] = new_lines(&mut logged, &malformed)[..] {
                    let (lines, problem) = (malformed.len(), not_a_job(first));
                    tracing::warn!(lines, problem, "a part of Slurm's queue cannot be read; the other jobs are");
                }
                let mut entries: HashMap<String, Vec<Entry>> = HashMap::new();
                for entry in list {
                    entries.entry(entry.name.clone()).or_default().push(entry);
                }
                let (entries, malformed) = (Arc::new(entries), malformed.into());
                let asked_at = Some(asked_at);
                shared.snapshots.send_replace(Snapshot { asked_at, entries, malformed, problem: None });
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

/// The malformed lines that the answer before did not have; `logged` has its lines, and then those of this one.
fn new_lines<'a>(logged: &mut HashSet<String>, malformed: &'a [String]) -> Vec<&'a str> {
    let new = malformed.iter().filter(|line| !logged.contains(*line)).map(String::as_str).collect();
    *logged = malformed.iter().cloned().collect();
    new
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_malformed_line_is_logged_once_while_it_is_listed() {
        let (mut logged, lines) = (HashSet::new(), ["a|1|".to_owned(), "b|2|".to_owned()]);
        assert_eq!(new_lines(&mut logged, &lines[..1]), ["a|1|"]);
        assert!(new_lines(&mut logged, &lines[..1]).is_empty());
        assert_eq!(new_lines(&mut logged, &lines), ["b|2|"]);
        assert!(new_lines(&mut logged, &[]).is_empty());
        assert_eq!(new_lines(&mut logged, &lines), ["a|1|", "b|2|"]);
    }
}
