//! The live scores of one session. A watch never blocks and never fails: a robot does not wait for its scores.

use std::sync::Arc;

use bytes::Bytes;
use gleaner_learn::LiveScorer;

use super::{
    Held,
    episode_queue::{EpisodeQueue, Stamped},
    model::{Scorer, Step},
};
use crate::{domain::score::SegmentScored, error::Error};

/// The decoded observation of one step.
#[derive(Debug, Clone)]
pub(crate) struct DecodedObservation {
    /// The stamp of the observation.
    pub(crate) stamp_ns: i64,
    /// Images in the model's layout: one step of `FrameBytes`.
    pub(crate) frames: Bytes,
    /// In physical units.
    pub(crate) proprioception: Vec<f32>,
}

/// Follows one running episode. Per step, [`Watch::saw`] takes the observation and [`Watch::executed`] the action once
/// it is known; that completes the segment, which is scored in the background.
pub(crate) struct Watch<S: Scorer = LiveScorer> {
    ready: Held<S>,
    queue: Arc<EpisodeQueue<S::History>>,
    /// The newest observation, while its action is unknown.
    open: Option<DecodedObservation>,
}

impl<S: Scorer> Watch<S> {
    pub(super) fn new(ready: Held<S>) -> Self {
        let queue = Arc::new(EpisodeQueue::new(ready.window()));
        Self { ready, queue, open: None }
    }

    /// Starts a gap of unknown steps. Segments that span it are not scored.
    pub(crate) fn gap(&mut self) {
        self.open = None;
        self.queue.break_off();
    }

    /// Takes the next observation. If the previous one has no executed action, its segment gets no score, nor do later
    /// ones that contain it.
    pub(crate) fn saw(&mut self, step: DecodedObservation) {
        if self.open.replace(step).is_some() {
            self.queue.break_off();
        }
    }

    /// Takes the action executed since the last observation, which completes its segment. When the scorer has been busy
    /// for too long, older segments are left out.
    pub(crate) fn executed(&mut self, action: &[f32]) {
        let Some(DecodedObservation { stamp_ns, frames, proprioception }) = self.open.take() else { return };
        let action = action.to_vec();
        let step = Step { stamp_ns, frames, proprioception, action, begins: false, scored: false };
        if self.queue.add(step) {
            self.ready.follow(&self.queue);
        }
    }

    /// The newest scored segment.
    pub(crate) fn newest(&self) -> Option<SegmentScored> {
        self.queue.newest().and_then(|stamped| self.named(stamped))
    }

    /// Waits until every completed segment is scored or left out.
    pub(crate) async fn settle(&mut self) {
        self.queue.settled().await;
    }

    /// The scores since the last call, oldest first; at most the newest 65,536.
    pub(crate) fn take_scored(&mut self) -> Vec<SegmentScored> {
        self.queue.take_scored().into_iter().filter_map(|stamped| self.named(stamped)).collect()
    }

    /// The number of completed segments without a score: the scorer was too busy or failed, or they span a left-out
    /// step.
    pub(crate) fn left_out(&self) -> u64 {
        self.queue.left_out()
    }

    /// The scoring error since the last call, if any.
    pub(crate) fn take_fault(&mut self) -> Option<Error> {
        self.queue.take_fault()
    }

    fn named(&self, (stamp_ns, score): Stamped) -> Option<SegmentScored> {
        let match_episode = self.ready.expert(score.match_episode)?.clone();
        Some(SegmentScored { stamp_ns, w: score.w, q: score.q, match_episode, match_step: score.match_step })
    }
}
