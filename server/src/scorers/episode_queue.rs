//! The queue between one running episode and its scorer: waiting steps, history, finished scores. Bounded on both ends.

use std::{
    collections::VecDeque,
    sync::{Mutex, MutexGuard, PoisonError},
};

use gleaner_learn::SegmentScore;
use tokio::sync::Notify;

use super::model::{Followed, Step, Stretch};
use crate::error::Error;

/// The most scores kept until they are taken: an hour of a fast robot, about three megabytes.
const KEPT: usize = 1 << 16;

/// A score with the stamp of its segment's last observation.
pub(super) type Stamped = (i64, SegmentScore);

/// Shared by a watch and a scorer's thread.
pub(crate) struct EpisodeQueue<H> {
    state: Mutex<State<H>>,
    settled: Notify,
    /// The steps of a whole segment.
    window: usize,
}

struct State<H> {
    waiting: VecDeque<Step>,
    history: Option<H>,
    /// The next step does not continue the previous one.
    broken: bool,
    /// Number of coming steps whose segments span a gap: they are incomplete and get no score.
    incomplete: usize,
    /// The thread was notified and has not taken the steps yet.
    notified: bool,
    /// The thread is working on steps of this episode.
    busy: bool,
    newest: Option<Stamped>,
    scored: VecDeque<Stamped>,
    /// Segments without a score: the scorer was too busy, or failed.
    left_out: u64,
    fault: Option<Error>,
}

impl<H> EpisodeQueue<H> {
    pub(super) fn new(window: usize) -> Self {
        let state = State {
            waiting: VecDeque::new(),
            history: None,
            broken: false,
            incomplete: 0,
            notified: false,
            busy: false,
            newest: None,
            scored: VecDeque::new(),
            left_out: 0,
            fault: None,
        };
        Self { state: Mutex::new(state), settled: Notify::new(), window: window.max(1) }
    }

    /// Adds a step. When too many wait, older ones are left out in favour of the newest whole segment. Returns whether
    /// the thread must be notified.
    pub(super) fn add(&self, mut step: Step) -> bool {
        let mut state = self.state();
        step.begins = std::mem::take(&mut state.broken);
        state.waiting.push_back(step);
        if state.waiting.len() > 2 * self.window {
            let left_out = state.waiting.len() - self.window;
            state.waiting.drain(..left_out);
            state.left_out += left_out as u64;
            state.break_here();
        }
        !std::mem::replace(&mut state.notified, true)
    }

    /// Starts a gap: the action executed at the last step is unknown.
    pub(super) fn break_off(&self) {
        self.state().broken = true;
    }

    /// Takes the waiting steps, to be scored by the thread.
    pub(super) fn take(&self) -> Option<Stretch<H>> {
        let mut state = self.state();
        state.notified = false;
        state.busy = !state.waiting.is_empty();
        if !state.busy {
            return None;
        }
        let mut steps = Vec::from(std::mem::take(&mut state.waiting));
        for step in &mut steps {
            if step.begins {
                state.incomplete = self.window - 1;
            }
            step.scored = state.incomplete == 0;
            state.left_out += u64::from(!step.scored);
            state.incomplete = state.incomplete.saturating_sub(1);
        }
        Some(Stretch { history: state.history.take(), steps })
    }

    /// Stores the scores of a stretch. After a failure the history is lost and starts again.
    pub(super) fn put(&self, stretch: &Stretch<H>, followed: Result<Followed<H>, Error>) {
        let mut state = self.state();
        state.busy = false;
        match followed {
            Ok(Followed { history, scores }) => {
                state.history = history;
                let stamps = stretch.steps.iter().filter(|step| step.scored).map(|step| step.stamp_ns);
                for stamped in stamps.zip(scores) {
                    state.newest = Some(stamped);
                    state.keep(stamped);
                }
            }
            Err(error) => {
                state.left_out += stretch.steps.iter().filter(|step| step.scored).count() as u64;
                state.break_here();
                if state.fault.is_none() {
                    tracing::warn!(%error, "live scoring failed; it restarts with the next steps");
                }
                state.fault = Some(error);
            }
        }
        drop(state);
        self.settled.notify_waiters();
    }

    /// Discards the waiting steps, which will not be scored.
    pub(super) fn give_up(&self) {
        let mut state = self.state();
        state.left_out += state.waiting.drain(..).count() as u64;
        state.notified = false;
        drop(state);
        self.settled.notify_waiters();
    }

    /// Waits until the queue is empty and no stretch is being scored.
    pub(super) async fn settled(&self) {
        loop {
            let settled = self.settled.notified();
            {
                let state = self.state();
                if state.waiting.is_empty() && !state.busy {
                    return;
                }
            }
            settled.await;
        }
    }

    pub(super) fn newest(&self) -> Option<Stamped> {
        self.state().newest
    }

    pub(super) fn take_scored(&self) -> VecDeque<Stamped> {
        std::mem::take(&mut self.state().scored)
    }

    pub(super) fn take_fault(&self) -> Option<Error> {
        self.state().fault.take()
    }

    pub(super) fn left_out(&self) -> u64 {
        self.state().left_out
    }

    fn state(&self) -> MutexGuard<'_, State<H>> {
        // Whole after every statement, so a panic elsewhere does not spoil it.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<H> State<H> {
    /// Starts a new history with the first waiting step, or else with the next one.
    fn break_here(&mut self) {
        match self.waiting.front_mut() {
            Some(first) => first.begins = true,
            None => self.broken = true,
        }
    }

    fn keep(&mut self, stamped: Stamped) {
        if self.scored.len() == KEPT {
            self.scored.pop_front();
        }
        self.scored.push_back(stamped);
    }
}
