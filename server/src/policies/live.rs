//! The state of running sessions for the pages: last images, scores and response times.
//!
//! A session publishes without waiting; readers take a copy. Entries are removed with their session.

use std::{
    collections::HashMap,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use crate::domain::{
    id::SessionId,
    live::{LiveSession, SessionState},
    observation::{Observation, Timings},
    score::SegmentScored,
    time::Millis,
};

/// Response times kept per session.
const REMEMBERED: usize = 256;

/// The running sessions; clones share them.
#[derive(Debug, Clone, Default)]
pub(super) struct Live(Arc<Mutex<HashMap<SessionId, Shown>>>);

#[derive(Debug, Clone)]
struct Shown {
    session: LiveSession,
    now: Arc<Mutex<SessionState>>,
}

/// A session's publishing end; dropping it removes the session.
#[derive(Debug)]
pub(super) struct Showing {
    live: Live,
    id: SessionId,
    now: Arc<Mutex<SessionState>>,
}

impl Live {
    /// Adds a session.
    pub(super) fn begin(&self, session: LiveSession) -> Showing {
        let (id, now) = (session.id.clone(), Arc::default());
        self.sessions().insert(id.clone(), Shown { session, now: Arc::clone(&now) });
        Showing { live: self.clone(), id, now }
    }

    /// Every running session, the newest first.
    pub(super) fn all(&self) -> Vec<(LiveSession, SessionState)> {
        // Each is copied after the list is unlocked: a session that opens must not wait for a reader.
        let shown: Vec<Shown> = self.sessions().values().cloned().collect();
        let mut all: Vec<_> = shown.into_iter().map(|shown| (shown.session, held(&shown.now).clone())).collect();
        all.sort_by(|(one, _), (other, _)| other.id.cmp(&one.id));
        all
    }

    /// One running session.
    pub(super) fn one(&self, id: &SessionId) -> Option<(LiveSession, SessionState)> {
        let shown = self.sessions().get(id).cloned()?;
        let now = held(&shown.now).clone();
        Some((shown.session, now))
    }

    fn sessions(&self) -> MutexGuard<'_, HashMap<SessionId, Shown>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Showing {
    /// Publishes to a list that is not read.
    #[cfg(test)]
    pub(super) fn nowhere() -> Self {
        Self { live: Live::default(), id: SessionId::new(), now: Arc::default() }
    }

    /// Publishes an observation.
    pub(super) fn saw(&self, observation: &Observation) {
        let mut now = held(&self.now);
        now.cameras.clone_from(&observation.cameras);
        now.seen_at = Some(Millis::now());
    }

    /// Publishes the timings of an answer.
    pub(super) fn answered(&self, timings: &Timings) {
        let mut now = held(&self.now);
        now.answered += 1;
        if now.total_us.len() == REMEMBERED {
            now.total_us.pop_front();
        }
        now.total_us.push_back(timings.total_us);
    }

    /// Publishes the score of a segment.
    pub(super) fn scored(&self, score: &SegmentScored) {
        held(&self.now).score = Some(score.clone());
    }
}

impl Drop for Showing {
    fn drop(&mut self) {
        self.live.sessions().remove(&self.id);
    }
}

fn held(now: &Mutex<SessionState>) -> MutexGuard<'_, SessionState> {
    now.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::domain::id::{PolicyId, TaskId};

    fn session() -> LiveSession {
        LiveSession {
            id: SessionId::new(),
            deployment: "arm".into(),
            policy_id: PolicyId::new(),
            task_id: TaskId::new(),
            since: Millis(1),
            recorded: false,
        }
    }

    #[test]
    fn a_session_is_listed_while_it_runs() {
        let live = Live::default();
        let (one, other) = (session(), session());
        let showing = live.begin(one.clone());
        let _other = live.begin(other.clone());
        showing.answered(&Timings { total_us: 7, ..Timings::default() });
        let ids: Vec<_> = live.all().into_iter().map(|(session, _)| session.id).collect();
        assert_eq!(ids, [other.id, one.id.clone()], "the newest first");
        let (_, now) = live.one(&one.id).unwrap();
        assert_eq!((now.answered, now.quantile_us(0.99)), (1, Some(7)));
        drop(showing);
        assert!(live.one(&one.id).is_none() && live.all().len() == 1);
    }

    #[test]
    fn quantiles_cover_the_newest_times() {
        let live = Live::default();
        let showing = live.begin(session());
        assert_eq!(SessionState::default().quantile_us(0.5), None);
        for total_us in 0..1000 {
            showing.answered(&Timings { total_us, ..Timings::default() });
        }
        let (_, now) = live.all().remove(0);
        assert_eq!((now.answered, now.total_us.len()), (1000, REMEMBERED));
        assert_eq!((now.quantile_us(0.5), now.quantile_us(1.0)), (Some(871), Some(999)));
    }
}
