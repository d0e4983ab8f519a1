//! A loaded scorer on its own thread. It serves waiting requests together and at low priority: a robot's next action is
//! worth more than the score of its last.

use std::{
    collections::VecDeque,
    sync::{Arc, Mutex, PoisonError},
    thread::JoinHandle,
};

use gleaner_learn::{EpisodeScores, TaskShape, Trajectory};
use tokio::sync::oneshot;

use super::{
    episode_queue::EpisodeQueue,
    model::{Followed, Scorer, Stretch},
};
use crate::{
    domain::id::ScoreRunId,
    error::{Error, Result, guarded},
    ingest::InspectionPermit,
};

/// The most running episodes in one batch.
const TOGETHER: usize = 32;
/// The niceness of a scorer's thread.
const NICE: i32 = 5;

/// A request to a scorer's thread.
enum Request<H> {
    /// Scores the new steps of a running episode.
    Follow(Arc<EpisodeQueue<H>>),
    /// Scores a whole episode.
    Episode(Box<Whole>),
}

/// A whole episode to be scored.
struct Whole {
    steps: Trajectory,
    reply: oneshot::Sender<Result<EpisodeScores>>,
    /// Released with the episode's memory, even if the caller is gone earlier.
    _room: InspectionPermit,
}

/// Shape and window of a loaded scorer, or the error of loading it.
type Loaded = Result<(TaskShape, usize)>;

/// A handle to a scorer's thread. The thread ends when the handle is dropped, or on `close`.
pub(super) struct Engine<S: Scorer> {
    shape: Arc<TaskShape>,
    window: usize,
    requests: Mutex<Option<flume::Sender<Request<S::History>>>>,
    thread: Mutex<Option<JoinHandle<()>>>,
}

impl<S: Scorer> Engine<S> {
    /// Starts a thread and loads a scorer on it with `load`.
    ///
    /// # Errors
    /// The error of `load`.
    pub(super) async fn start(run: &ScoreRunId, load: impl FnOnce() -> Result<S> + Send + 'static) -> Result<Self> {
        // Unbounded, yet small: each running episode has at most one request in it, and each whole episode holds its
        // room.
        let (requests, receiver) = flume::unbounded();
        let (loaded_sender, loaded) = oneshot::channel();
        let thread = std::thread::Builder::new()
            .name(format!("scorer {run}"))
            .spawn(move || {
                if let Some(scorer) = load_on_thread(load, loaded_sender) {
                    serve(&scorer, &receiver);
                }
            })
            .map_err(|error| Error::internal("starting a scorer's thread", error))?;
        let (shape, window) = loaded.await.map_err(|error| Error::internal("loading a scorer", error))??;
        tracing::info!(score_run.id = %run, "scorer loaded");
        let (requests, thread) = (Mutex::new(Some(requests)), Mutex::new(Some(thread)));
        Ok(Self { shape: Arc::new(shape), window, requests, thread })
    }

    pub(super) fn shape(&self) -> &Arc<TaskShape> {
        &self.shape
    }

    pub(super) fn window(&self) -> usize {
        self.window
    }

    /// Queues a running episode.
    pub(super) fn follow(&self, queue: &Arc<EpisodeQueue<S::History>>) {
        let requests = self.requests.lock().unwrap_or_else(PoisonError::into_inner);
        let sent = requests.as_ref().is_some_and(|requests| requests.send(Request::Follow(Arc::clone(queue))).is_ok());
        if !sent {
            queue.give_up();
        }
    }

    /// The scores of a whole episode.
    ///
    /// # Errors
    /// Invalid when it does not fit the task; Unavailable when the scorer is being unloaded; Internal when it fails.
    pub(super) async fn episode(&self, steps: Trajectory, room: InspectionPermit) -> Result<EpisodeScores> {
        let (reply, answer) = oneshot::channel();
        let requests = self.requests.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let whole = Box::new(Whole { steps, reply, _room: room });
        let sent = requests.is_some_and(|requests| requests.send(Request::Episode(whole)).is_ok());
        match answer.await {
            Ok(scores) if sent => scores,
            Ok(_) | Err(_) => Err(unloading()),
        }
    }

    /// Accepts no more requests; blocks until waiting running episodes are scored and the thread has ended.
    pub(super) fn close(&self) {
        drop(self.requests.lock().unwrap_or_else(PoisonError::into_inner).take());
        let thread = self.thread.lock().unwrap_or_else(PoisonError::into_inner).take();
        if thread.is_some_and(|thread| thread.join().is_err()) {
            tracing::error!("a scorer's thread panicked");
        }
    }
}

/// Loads the scorer on its thread and sends its shape. `None` when loading failed or the caller is gone.
fn load_on_thread<S: Scorer>(load: impl FnOnce() -> Result<S>, loaded_sender: oneshot::Sender<Loaded>) -> Option<S> {
    // One thread per model: several would compete for the processors and delay every reply.
    gleaner_learn::set_threads(1);
    let loaded = guarded("loading a scorer", load);
    // Of this thread alone, on Linux.
    if let Err(error) = rustix::process::setpriority_process(None, NICE) {
        tracing::warn!(%error, "a scorer runs at normal priority");
    }
    match loaded {
        Ok(scorer) => {
            let shape_and_window = (scorer.shape().clone(), scorer.window());
            loaded_sender.send(Ok(shape_and_window)).is_ok().then_some(scorer)
        }
        Err(error) => {
            // The caller may be gone.
            let _ = loaded_sender.send(Err(error));
            None
        }
    }
}

/// Serves until every sender is dropped. Running episodes are batched; whole episodes run alone, and are refused once
/// the channel is closed: the stop does not wait for them.
fn serve<S: Scorer>(scorer: &S, requests: &flume::Receiver<Request<S::History>>) {
    let mut put_off = VecDeque::new();
    while let Some(first) = put_off.pop_front().or_else(|| requests.recv().ok()) {
        match first {
            Request::Episode(whole) => {
                let Whole { steps, reply, _room } = *whole;
                if !reply.is_closed() {
                    let scores = match requests.is_disconnected() {
                        true => Err(unloading()),
                        false => guarded("scoring an episode", || scorer.episode(&steps)),
                    };
                    // The caller may be gone.
                    let _ = reply.send(scores);
                }
            }
            Request::Follow(queue) => {
                let mut queues = vec![queue];
                while queues.len() < TOGETHER
                    && let Ok(next) = requests.try_recv()
                {
                    match next {
                        Request::Follow(queue) => queues.push(queue),
                        Request::Episode(..) => put_off.push_back(next),
                    }
                }
                follow(scorer, &queues);
            }
        }
    }
}

/// Scores the new steps of running episodes. If the batch fails, each episode is scored alone, so that only the faulty
/// one fails.
fn follow<S: Scorer>(scorer: &S, queues: &[Arc<EpisodeQueue<S::History>>]) {
    // A queue held by this thread alone: its watch was dropped.
    let watched = queues.iter().filter(|queue| Arc::strong_count(queue) > 1);
    let taken: Vec<_> = watched.filter_map(|queue| queue.take().map(|stretch| (queue, stretch))).collect();
    let stretches: Vec<&Stretch<S::History>> = taken.iter().map(|(_, stretch)| stretch).collect();
    if stretches.is_empty() {
        return;
    }
    match (answer(scorer, &stretches), taken.as_slice()) {
        (Ok(followed), taken) => {
            for ((queue, stretch), followed) in taken.iter().zip(followed) {
                queue.put(stretch, Ok(followed));
            }
        }
        (Err(error), [(queue, stretch)]) => queue.put(stretch, Err(error)),
        (Err(error), taken) => {
            tracing::warn!(%error, batch.episodes = taken.len(), "a batch failed; scoring its episodes one by one");
            for (queue, stretch) in taken {
                let alone = answer(scorer, &[stretch]).and_then(|mut one| one.pop().ok_or_else(miscounted));
                queue.put(stretch, alone);
            }
        }
    }
}

/// Scores a batch and checks the output: one entry per stretch, one score per step to be scored.
fn answer<S: Scorer>(scorer: &S, stretches: &[&Stretch<S::History>]) -> Result<Vec<Followed<S::History>>> {
    let followed = guarded("scoring", || scorer.follow(stretches))?;
    let expected = stretches.iter().map(|stretch| stretch.steps.iter().filter(|step| step.scored).count());
    match followed.iter().map(|followed| followed.scores.len()).eq(expected) {
        true => Ok(followed),
        false => Err(miscounted()),
    }
}

fn unloading() -> Error {
    Error::unavailable("the scorer is being unloaded or the server is stopping; retry")
}

fn miscounted() -> Error {
    Error::internal("scoring", "the number of scores differs from the number of steps to be scored")
}
