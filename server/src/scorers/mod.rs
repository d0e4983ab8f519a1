//! Finished score runs kept ready: they score what is not stored, a session's steps while it runs or a whole episode,
//! as the run scored its own.
//!
//! A run is loaded when it is first asked for, once however many ask. Knows no wire type and no SQL.

mod engine;
mod line;
mod load;
mod model;
mod shelf;
mod steps;
#[cfg(test)]
mod testing;
#[cfg(test)]
mod tests;
mod watch;

use std::sync::{Arc, Weak};

use gleaner_learn::{EpisodeScores, LearnError, LiveScorer, TaskShape, Trajectory};
use gleaner_recording::Episode as Steps;

use self::{engine::Engine, line::Line, shelf::Shelf};
pub(crate) use self::{
    model::Scorer,
    steps::{Output, Terms, score_steps},
    watch::{Seen, Watch},
};
use crate::{
    blobs::Blobs,
    domain::{
        id::{EpisodeId, ScoreRunId},
        task::Task,
    },
    error::{Error, Result},
    ingest::{Ingest, Room},
    store::Store,
};

/// Every run that is ready; clones share them.
#[derive(Clone)]
pub struct Scorers(Arc<Inner>);

struct Inner {
    store: Store,
    blobs: Blobs,
    ingest: Ingest,
    shelf: Arc<Shelf<LiveScorer>>,
}

impl Scorers {
    /// Loads nothing yet. `most` runs stay in memory when nobody uses them.
    pub fn new(most: usize, store: Store, blobs: Blobs, ingest: Ingest) -> Self {
        Self(Arc::new(Inner { store, blobs, ingest, shelf: Shelf::new(most) }))
    }

    /// A run, ready; loaded now if it is not yet. Kept while somebody holds it.
    ///
    /// # Errors
    /// NotFound; Precondition when its job has not succeeded, when it cannot score what is not stored, or when its
    /// encoder cannot be read by this version; Unavailable when the server is stopping.
    pub(crate) async fn load(&self, run: &ScoreRunId) -> Result<Arc<Ready>> {
        let (inner, of) = (Arc::clone(&self.0), run.clone());
        let load = move || async move {
            load::ready(&inner.store, &inner.blobs, &inner.ingest, &of, Arc::downgrade(&inner.shelf)).await
        };
        self.0.shelf.ready(run, load).await
    }

    /// Unloads every run: what waits is scored, what comes later is refused.
    pub async fn stop(&self) {
        let engines = self.0.shelf.stop();
        let closing = tokio::task::spawn_blocking(move || engines.iter().for_each(|ready| ready.engine.close()));
        if let Err(error) = closing.await {
            tracing::error!(%error, "unloading scorers failed");
        }
    }
}

/// A run that is ready.
pub(crate) struct Ready<S: Scorer = LiveScorer> {
    task: Task,
    /// What matches count in.
    experts: Vec<EpisodeId>,
    engine: Engine<S>,
    shelf: Weak<Shelf<S>>,
}

impl<S: Scorer> Ready<S> {
    /// The way of a session that begins now to its scores.
    pub(crate) fn watch(self: &Arc<Self>) -> Watch<S> {
        Watch::new(Arc::clone(self))
    }

    /// The task whose episodes it scores.
    pub(crate) fn task(&self) -> &Task {
        &self.task
    }

    /// What a step must hold.
    pub(crate) fn shape(&self) -> &Arc<TaskShape> {
        self.engine.shape()
    }

    /// What matches count in.
    pub(crate) fn experts(&self) -> &[EpisodeId] {
        &self.experts
    }

    /// The scores of every segment of a recording that is not stored, as the run would have given them. `room` is held
    /// for as long as the recording is in memory.
    ///
    /// # Errors
    /// Invalid when it does not fit; Unavailable when the server is stopping; Internal.
    pub(crate) async fn score_recording(&self, steps: &Steps, room: Room) -> Result<EpisodeScores> {
        let recording = trajectory(self.shape(), "recording", steps);
        self.engine.episode(recording.map_err(|error| Error::learned("scoring a recording", error))?, room).await
    }

    fn window(&self) -> usize {
        self.engine.window()
    }

    fn follow(&self, line: &Arc<Line<S::History>>) {
        self.engine.follow(line);
    }

    /// The expert episode of a match.
    fn expert(&self, place: u32) -> Option<&EpisodeId> {
        usize::try_from(place).ok().and_then(|place| self.experts.get(place))
    }

    /// Somebody who holds it is about to let go.
    fn part(self: &Arc<Self>) {
        if let Some(shelf) = self.shelf.upgrade() {
            shelf.make_room(Some(self));
        }
    }
}

/// Decoded steps as models take them: mapped, not copied, but for the numbers.
fn trajectory(shape: &TaskShape, id: &str, steps: &Steps) -> std::result::Result<Trajectory, LearnError> {
    Trajectory::new(shape, id, Arc::new(steps.frames()), steps.proprioception(), steps.action())
}
