//! One session's way to a score. It never blocks and never fails: a robot does not wait for how well it does.

use std::sync::Arc;

use bytes::Bytes;
use gleaner_learn::LiveScorer;

use super::{
    Ready,
    line::{Line, Stamped},
    model::{Scorer, Step},
};
use crate::{domain::score::SegmentScored, error::Error};

/// What was seen at one step, decoded.
#[derive(Debug, Clone)]
pub(crate) struct Seen {
    /// Of the observation.
    pub(crate) stamp_ns: i64,
    /// Images as models take them: one step of `FrameBytes`.
    pub(crate) frames: Bytes,
    /// In physical units.
    pub(crate) proprioception: Vec<f32>,
}

/// Follows one running episode. Per step: [`Watch::saw`] what was seen, then, once it is known,
/// [`Watch::executed`] what was done; that completes the segment, which is scored in its own time.
pub(crate) struct Watch<S: Scorer = LiveScorer> {
    ready: Arc<Ready<S>>,
    line: Arc<Line<S::History>>,
    /// Seen, but what was done is not known yet.
    open: Option<Seen>,
}

impl<S: Scorer> Watch<S> {
    pub(super) fn new(ready: Arc<Ready<S>>) -> Self {
        let line = Arc::new(Line::new(ready.window()));
        Self { ready, line, open: None }
    }

    /// Steps have passed that this does not know. No segment reaches back over them.
    pub(crate) fn gap(&mut self) {
        self.open = None;
        self.line.break_off();
    }

    /// The next observation. If nothing was said of the action since the one before, its segment has no score, nor
    /// have the next ones until they hold only steps from here on.
    pub(crate) fn saw(&mut self, step: Seen) {
        if self.open.replace(step).is_some() {
            self.line.break_off();
        }
    }

    /// The action that was really executed since the last observation: completes its segment. When the scorer has
    /// been busy for too long, older segments are left out.
    pub(crate) fn executed(&mut self, action: &[f32]) {
        let Some(Seen { stamp_ns, frames, proprioception }) = self.open.take() else { return };
        let action = action.to_vec();
        let step = Step { stamp_ns, frames, proprioception, action, begins: false, scored: false };
        if self.line.add(step) {
            self.ready.follow(&self.line);
        }
    }

    /// The newest segment that has been scored.
    pub(crate) fn newest(&self) -> Option<SegmentScored> {
        self.line.newest().and_then(|stamped| self.named(stamped))
    }

    /// Waits until every segment that was completed is scored, or left out.
    pub(crate) async fn settle(&mut self) {
        self.line.settled().await;
    }

    /// What was scored since this was asked last, oldest first; the newest 65,536, if it is not asked for longer.
    pub(crate) fn take_scored(&mut self) -> Vec<SegmentScored> {
        self.line.take_scored().into_iter().filter_map(|stamped| self.named(stamped)).collect()
    }

    /// Segments so far that were completed and get no score: the scorer was too busy, or failed, or they reach back
    /// over a step that was left out.
    pub(crate) fn left_out(&self) -> u64 {
        self.line.left_out()
    }

    /// Why scoring failed since this was asked last, if it did.
    pub(crate) fn take_fault(&mut self) -> Option<Error> {
        self.line.take_fault()
    }

    fn named(&self, (stamp_ns, score): Stamped) -> Option<SegmentScored> {
        let match_episode = self.ready.expert(score.match_episode)?.clone();
        Some(SegmentScored { stamp_ns, w: score.w, q: score.q, match_episode, match_step: score.match_step })
    }
}

impl<S: Scorer> Drop for Watch<S> {
    fn drop(&mut self) {
        // What only it held may go.
        self.ready.part();
    }
}
