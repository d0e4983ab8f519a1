//! One running episode on its way to its scorer: what waits, what is remembered, what came out. Bounded, whatever its
//! two ends do.

use std::{
    collections::VecDeque,
    sync::{Mutex, MutexGuard, PoisonError},
};

use gleaner_learn::SegmentScore;
use tokio::sync::Notify;

use super::model::{Followed, Step, Stretch};
use crate::error::Error;

/// Most scores kept until somebody takes them: an hour of a fast robot, about three megabytes.
const KEPT: usize = 1 << 16;

/// A score, with the stamp of its segment's last observation.
pub(super) type Stamped = (i64, SegmentScore);

/// What a watch and a scorer's thread share.
pub(crate) struct Line<H> {
    state: Mutex<State<H>>,
    settled: Notify,
    /// Steps of a whole segment.
    window: usize,
}

struct State<H> {
    waiting: VecDeque<Step>,
    history: Option<H>,
    /// The next step does not follow the one before.
    broken: bool,
    /// Steps to come whose segments reach back over a gap: they are not whole and get no score.
    unwhole: usize,
    /// The thread has been told, and has not come yet.
    told: bool,
    /// The thread has steps of it.
    busy: bool,
    newest: Option<Stamped>,
    scored: VecDeque<Stamped>,
    /// Segments that get no score: the scorer was too busy, or failed.
    left_out: u64,
    fault: Option<Error>,
}

impl<H> Line<H> {
    pub(super) fn new(window: usize) -> Self {
        let state = State {
            waiting: VecDeque::new(),
            history: None,
            broken: false,
            unwhole: 0,
            told: false,
            busy: false,
            newest: None,
            scored: VecDeque::new(),
            left_out: 0,
            fault: None,
        };
        Self { state: Mutex::new(state), settled: Notify::new(), window: window.max(1) }
    }

    /// Adds a step. When too many wait, the older ones are left out: the newest whole segment is worth more. Says
    /// whether the thread must be told.
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
        !std::mem::replace(&mut state.told, true)
    }

    /// The step to come does not follow the one before: what was done at that one is not known.
    pub(super) fn break_off(&self) {
        self.state().broken = true;
    }

    /// What waits, for the thread to work on.
    pub(super) fn take(&self) -> Option<Stretch<H>> {
        let mut state = self.state();
        state.told = false;
        state.busy = !state.waiting.is_empty();
        if !state.busy {
            return None;
        }
        let mut steps = Vec::from(std::mem::take(&mut state.waiting));
        for step in &mut steps {
            if step.begins {
                state.unwhole = self.window - 1;
            }
            step.scored = state.unwhole == 0;
            state.left_out += u64::from(!step.scored);
            state.unwhole = state.unwhole.saturating_sub(1);
        }
        Some(Stretch { history: state.history.take(), steps })
    }

    /// The thread is done with a stretch. After a fault the history is lost, and begins anew.
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
                    tracing::warn!(%error, "live scoring failed; it begins anew with the next steps");
                }
                state.fault = Some(error);
            }
        }
        drop(state);
        self.settled.notify_waiters();
    }

    /// Forgets what waits: nobody will score it any more.
    pub(super) fn give_up(&self) {
        let mut state = self.state();
        state.left_out += state.waiting.drain(..).count() as u64;
        state.told = false;
        drop(state);
        self.settled.notify_waiters();
    }

    /// Waits until nothing waits.
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
        // The state is whole after every statement that can panic, of which there is none but allocation.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<H> State<H> {
    /// What waits, or else what comes, goes on from nothing.
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
