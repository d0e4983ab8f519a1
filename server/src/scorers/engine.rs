//! One loaded scorer on a thread of its own. It serves what waits together, and gives way to everything else: a robot's
//! next action is worth more than the score of its last.

use std::{
    collections::VecDeque,
    sync::{Arc, Mutex, PoisonError},
    thread::JoinHandle,
};

use gleaner_learn::{EpisodeScores, TaskShape, Trajectory};
use tokio::sync::oneshot;

use super::{
    line::Line,
    model::{Followed, Scorer, Stretch},
};
use crate::{
    domain::id::ScoreRunId,
    error::{Error, Result, guarded},
    ingest::Room,
};

/// Most episodes that are scored together.
const TOGETHER: usize = 32;
/// The niceness of a scorer's thread.
const NICE: i32 = 5;

/// What a scorer's thread is asked.
enum Ask<H> {
    /// To go on with a running episode.
    Follow(Arc<Line<H>>),
    /// To score a whole one.
    Episode(Box<Whole>),
}

/// A whole episode to be scored.
struct Whole {
    steps: Trajectory,
    reply: oneshot::Sender<Result<EpisodeScores>>,
    /// Given back when the episode is gone, even if its caller goes before.
    _room: Room,
}

/// What a scorer says of itself once it is loaded.
type Loaded = Result<(TaskShape, usize)>;

/// A handle to a scorer's thread. The thread ends when the handle is gone, or on `close`.
pub(super) struct Engine<S: Scorer> {
    shape: Arc<TaskShape>,
    window: usize,
    asks: Mutex<Option<flume::Sender<Ask<S::History>>>>,
    thread: Mutex<Option<JoinHandle<()>>>,
}

impl<S: Scorer> Engine<S> {
    /// Starts a thread and loads a scorer on it with `load`.
    ///
    /// # Errors
    /// What `load` says.
    pub(super) async fn start(run: &ScoreRunId, load: impl FnOnce() -> Result<S> + Send + 'static) -> Result<Self> {
        // Unbounded, yet small: each running episode has at most one ask in it, each whole one has its room.
        let (asks, asked) = flume::unbounded();
        let (tell, told) = oneshot::channel();
        let thread = std::thread::Builder::new()
            .name(format!("scorer {run}"))
            .spawn(move || {
                if let Some(scorer) = loaded(load, tell) {
                    serve(&scorer, &asked);
                }
            })
            .map_err(|error| Error::internal("starting a scorer's thread", error))?;
        let (shape, window) = told.await.map_err(|error| Error::internal("loading a scorer", error))??;
        tracing::info!(score_run.id = %run, "scorer loaded");
        let (asks, thread) = (Mutex::new(Some(asks)), Mutex::new(Some(thread)));
        Ok(Self { shape: Arc::new(shape), window, asks, thread })
    }

    pub(super) fn shape(&self) -> &Arc<TaskShape> {
        &self.shape
    }

    pub(super) fn window(&self) -> usize {
        self.window
    }

    /// Has the thread go on with a running episode, soon.
    pub(super) fn follow(&self, line: &Arc<Line<S::History>>) {
        let asks = self.asks.lock().unwrap_or_else(PoisonError::into_inner);
        let told = asks.as_ref().is_some_and(|asks| asks.send(Ask::Follow(Arc::clone(line))).is_ok());
        if !told {
            line.give_up();
        }
    }

    /// The scores of a whole episode.
    ///
    /// # Errors
    /// Invalid when it does not fit; Unavailable when the scorer is being unloaded; Internal when it fails.
    pub(super) async fn episode(&self, steps: Trajectory, room: Room) -> Result<EpisodeScores> {
        let (reply, answer) = oneshot::channel();
        let asks = self.asks.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let whole = Box::new(Whole { steps, reply, _room: room });
        let asked = asks.is_some_and(|asks| asks.send(Ask::Episode(whole)).is_ok());
        match answer.await {
            Ok(scores) if asked => scores,
            Ok(_) | Err(_) => Err(unloading()),
        }
    }

    /// Takes nothing more and waits, blocking, until the running episodes that wait are done and the thread has ended.
    pub(super) fn close(&self) {
        drop(self.asks.lock().unwrap_or_else(PoisonError::into_inner).take());
        let thread = self.thread.lock().unwrap_or_else(PoisonError::into_inner).take();
        if thread.is_some_and(|thread| thread.join().is_err()) {
            tracing::error!("a scorer's thread had panicked");
        }
    }
}

/// The beginning of a scorer's thread. `None` when loading failed or nobody listens.
fn loaded<S: Scorer>(load: impl FnOnce() -> Result<S>, tell: oneshot::Sender<Loaded>) -> Option<S> {
    // One thread a model: several would fight over the processors and make every answer late.
    gleaner_learn::set_threads(1);
    let loaded = guarded("loading a scorer", load);
    // Of this thread alone, on Linux.
    if let Err(error) = rustix::process::setpriority_process(None, NICE) {
        tracing::warn!(%error, "a scorer runs at normal priority");
    }
    match loaded {
        Ok(scorer) => {
            let says = (scorer.shape().clone(), scorer.window());
            tell.send(Ok(says)).is_ok().then_some(scorer)
        }
        Err(error) => {
            // Nobody listens when the caller has gone.
            let _ = tell.send(Err(error));
            None
        }
    }
}

/// Serves until nobody can ask any more. Running episodes that wait go together; a whole one goes alone, and is refused
/// once nothing more may come: the stop does not wait for it.
fn serve<S: Scorer>(scorer: &S, asked: &flume::Receiver<Ask<S::History>>) {
    let mut put_off = VecDeque::new();
    while let Some(first) = put_off.pop_front().or_else(|| asked.recv().ok()) {
        match first {
            Ask::Episode(whole) => {
                let Whole { steps, reply, _room } = *whole;
                if !reply.is_closed() {
                    let scores = match asked.is_disconnected() {
                        true => Err(unloading()),
                        false => guarded("scoring an episode", || scorer.episode(&steps)),
                    };
                    // A caller that has gone needs no answer.
                    let _ = reply.send(scores);
                }
            }
            Ask::Follow(line) => {
                let mut lines = vec![line];
                while lines.len() < TOGETHER
                    && let Ok(next) = asked.try_recv()
                {
                    match next {
                        Ask::Follow(line) => lines.push(line),
                        Ask::Episode(..) => put_off.push_back(next),
                    }
                }
                follow(scorer, &lines);
            }
        }
    }
}

/// Goes on with episodes. If that fails as a whole, each is tried alone, so that only the one at fault fails.
fn follow<S: Scorer>(scorer: &S, lines: &[Arc<Line<S::History>>]) {
    // A line that only this thread holds: its watch has gone.
    let watched = lines.iter().filter(|line| Arc::strong_count(line) > 1);
    let taken: Vec<_> = watched.filter_map(|line| line.take().map(|stretch| (line, stretch))).collect();
    let stretches: Vec<&Stretch<S::History>> = taken.iter().map(|(_, stretch)| stretch).collect();
    if stretches.is_empty() {
        return;
    }
    match (answer(scorer, &stretches), taken.as_slice()) {
        (Ok(followed), taken) => {
            for ((line, stretch), followed) in taken.iter().zip(followed) {
                line.put(stretch, Ok(followed));
            }
        }
        (Err(error), [(line, stretch)]) => line.put(stretch, Err(error)),
        (Err(error), taken) => {
            tracing::warn!(%error, batch.episodes = taken.len(), "a batch failed; scoring its episodes one by one");
            for (line, stretch) in taken {
                let alone = answer(scorer, &[stretch]).and_then(|mut one| one.pop().ok_or_else(miscounted));
                line.put(stretch, alone);
            }
        }
    }
}

/// Follows and checks what came: one entry for each stretch, one score for each step that has one.
fn answer<S: Scorer>(scorer: &S, stretches: &[&Stretch<S::History>]) -> Result<Vec<Followed<S::History>>> {
    let followed = guarded("scoring", || scorer.follow(stretches))?;
    let wanted = stretches.iter().map(|stretch| stretch.steps.iter().filter(|step| step.scored).count());
    match followed.iter().map(|followed| followed.scores.len()).eq(wanted) {
        true => Ok(followed),
        false => Err(miscounted()),
    }
}

fn unloading() -> Error {
    Error::unavailable("the scorer is being unloaded or the server is stopping; try again")
}

fn miscounted() -> Error {
    Error::internal("scoring", "the scorer gave another number of scores than it was asked")
}
