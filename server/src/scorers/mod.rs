//! Loaded score runs. They score episodes that are not stored (a running session's steps, or a whole recording) as the
//! run scored its own.
//!
//! A run is loaded on first use, once for all concurrent callers. Must not depend on wire types or SQL.

mod engine;
mod episode_queue;
mod held;
mod load;
mod loaded_runs;
mod model;
mod source;
mod steps;
#[cfg(test)]
mod testing;
#[cfg(test)]
mod tests;
mod watch;

use std::sync::{Arc, Weak};

use gleaner_learn::{EpisodeScores, LiveScorer, TaskShape, Trajectory};
use gleaner_recording::FrameCache;

use self::{engine::Engine, episode_queue::EpisodeQueue, loaded_runs::LoadedRuns, source::Unstored};
pub(crate) use self::{
    held::Held,
    model::Scorer,
    steps::{Output, Terms, score_steps},
    watch::{DecodedObservation, Watch},
};
use crate::{
    blobs::Blobs,
    domain::{
        id::{EpisodeId, ScoreRunId},
        task::Task,
    },
    error::Result,
    ingest::{Ingest, InspectionPermit},
    store::Store,
};

/// All loaded runs; clones share them.
#[derive(Clone)]
pub struct Scorers(Arc<Inner>);

struct Inner {
    store: Store,
    blobs: Blobs,
    ingest: Ingest,
    loaded: Arc<LoadedRuns<LiveScorer>>,
}

impl Scorers {
    /// Loads no run yet. Up to `most` runs stay in memory without users.
    pub fn new(most: usize, store: Store, blobs: Blobs, ingest: Ingest) -> Self {
        Self(Arc::new(Inner { store, blobs, ingest, loaded: LoadedRuns::new(most) }))
    }

    /// Returns a run; loads it if needed. It stays loaded while a caller holds it: by a watch, or by [`Ready::held`].
    ///
    /// # Errors
    /// NotFound; Precondition when its job has not succeeded, when it was imported or its scorer cannot score live, or
    /// when its encoder cannot be read by this version; Unavailable when the server is stopping.
    pub(crate) async fn load(&self, run: &ScoreRunId) -> Result<Arc<Ready>> {
        let (inner, of) = (Arc::clone(&self.0), run.clone());
        let load = move || async move {
            load::ready(&inner.store, &inner.blobs, &inner.ingest, &of, Arc::downgrade(&inner.loaded)).await
        };
        self.0.loaded.ready(run, load).await
    }

    /// Unloads every run: queued steps are scored, later ones are refused.
    pub async fn stop(&self) {
        let engines = self.0.loaded.stop();
        let closing = tokio::task::spawn_blocking(move || engines.iter().for_each(|ready| ready.engine.close()));
        if let Err(error) = closing.await {
            tracing::error!(%error, "unloading scorers failed");
        }
    }
}

/// A loaded run.
pub(crate) struct Ready<S: Scorer = LiveScorer> {
    task: Task,
    /// The experts, indexed by matches.
    experts: Vec<EpisodeId>,
    engine: Engine<S>,
    loaded: Weak<LoadedRuns<S>>,
}

impl<S: Scorer> Ready<S> {
    /// A live scorer for a session that begins now.
    pub(crate) fn watch(self: &Arc<Self>) -> Watch<S> {
        Watch::new(Arc::clone(self).held())
    }

    /// The run for a caller that uses it without a watch.
    pub(crate) fn held(self: Arc<Self>) -> Held<S> {
        Held::new(self)
    }

    /// The task whose episodes it scores.
    pub(crate) fn task(&self) -> &Task {
        &self.task
    }

    /// The shape of a step.
    pub(crate) fn shape(&self) -> &Arc<TaskShape> {
        self.engine.shape()
    }

    /// The experts, indexed by matches.
    pub(crate) fn experts(&self) -> &[EpisodeId] {
        &self.experts
    }

    /// The scores of every segment of a recording that is not stored, as the run would have scored them. `room` is held
    /// while the recording is read.
    ///
    /// # Errors
    /// Invalid when it does not fit the task; Unavailable when the server is stopping; Internal.
    pub(crate) async fn score_recording(&self, steps: &FrameCache, room: InspectionPermit) -> Result<EpisodeScores> {
        let steps = Arc::new(Unstored { steps: steps.clone(), widths: (&**self.shape()).into() });
        let recording = Trajectory::read_from(self.shape(), "recording", steps);
        self.engine.episode(recording.map_err(|error| error.during("scoring a recording"))?, room).await
    }

    fn window(&self) -> usize {
        self.engine.window()
    }

    fn follow(&self, queue: &Arc<EpisodeQueue<S::History>>) {
        self.engine.follow(queue);
    }

    /// The expert episode of a match.
    fn expert(&self, place: u32) -> Option<&EpisodeId> {
        usize::try_from(place).ok().and_then(|place| self.experts.get(place))
    }
}
