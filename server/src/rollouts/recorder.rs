//! A session's end of its recording. Nothing here waits: what there is no room for is left out and counted.

use serde_json::json;
use tokio::sync::{mpsc, oneshot};

use super::{
    event::{Ending, Event, Note, Queue, bytes},
    steps::Steps,
};
use crate::{
    domain::{
        episode::Outcome,
        id::EpisodeId,
        observation::{Acted, Observation},
        score::SegmentScored,
    },
    error::{Error, Result},
};

/// Where the policy's chunks and the segments' scores go. No mapping reads them.
const COMMANDS: &str = "/policy/action";
const SCORES: &str = "/policy/score";
/// Most bytes of a number as text.
const NUMBER_BYTES: usize = 24;

/// How many observations a session answered, passed over, and could not answer in time.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Tally {
    pub(crate) answered: u64,
    pub(crate) dropped: u64,
    pub(crate) missed: u64,
    /// Segments that were to be scored and could not be; `None`: nobody counted them.
    pub(crate) unscored: Option<u64>,
}

/// Records one session. Dropped, it keeps what came so far, with an unknown outcome.
pub(crate) struct Recorder {
    events: mpsc::UnboundedSender<Event>,
    queue: Queue,
    steps: Steps<super::event::Room>,
    left_out: u64,
}

impl Recorder {
    pub(super) fn new(events: mpsc::UnboundedSender<Event>, action_size: usize) -> Self {
        Self { events, queue: Queue::new(), steps: Steps::new(action_size), left_out: 0 }
    }

    /// An observation has come, whatever becomes of it.
    pub(crate) fn observed(&mut self, observation: &Observation) {
        let room = self.queue.room(bytes(observation));
        if room.is_none() {
            self.leave_out();
        }
        self.steps.observe(observation, room);
        self.send_steps();
    }

    /// The observation of this stamp goes to the model.
    pub(crate) fn asks(&mut self, stamp_ns: i64) {
        self.steps.asks(stamp_ns);
    }

    /// What the model had is back; `sound` says that it was decoded.
    pub(crate) fn turned(&mut self, sound: bool) {
        self.steps.turned(sound);
        self.send_steps();
    }

    /// The robot was given these actions.
    pub(crate) fn commanded(&mut self, acted: &Acted) {
        if let Some(first) = acted.actions.first() {
            self.steps.does(first);
        }
        let value = || json!({"observation_stamp_ns": acted.stamp_ns, "actions": acted.actions});
        let numbers = acted.actions.iter().map(Vec::len).sum::<usize>();
        self.note(COMMANDS, acted.stamp_ns, numbers * NUMBER_BYTES, value);
    }

    /// A segment was scored.
    pub(crate) fn scored(&mut self, scored: &SegmentScored) {
        let SegmentScored { stamp_ns, w, q, match_episode, match_step } = scored;
        let value = || json!({"w": w, "q": q, "match_episode_id": match_episode.as_str(), "match_step": match_step});
        self.note(SCORES, *stamp_ns, 128, value);
    }

    /// Ends the recording and waits until the episode is stored; `None` when there is none, for want of steps.
    ///
    /// # Errors
    /// When the recording cannot be kept: the server's log says where it is.
    pub(crate) async fn finish(self, outcome: Outcome, how: &str, tally: Tally) -> Result<Option<EpisodeId>> {
        let lost = || Error::internal("keeping a recording", "its task has ended");
        self.end(outcome, how, tally).await.map_err(|_| lost())?
    }

    /// Ends the recording; it is kept in its own time.
    pub(crate) fn end(
        mut self,
        outcome: Outcome,
        how: &str,
        tally: Tally,
    ) -> oneshot::Receiver<Result<Option<EpisodeId>>> {
        self.steps.end();
        self.send_steps();
        let Tally { answered, dropped, missed, unscored } = tally;
        let ending =
            Ending { outcome, how: how.to_owned(), answered, dropped, missed, unscored, left_out: self.left_out };
        let (tell, told) = oneshot::channel();
        self.send(Event::End(ending, tell));
        told
    }

    fn note(&mut self, topic: &'static str, stamp_ns: i64, bytes: usize, value: impl FnOnce() -> serde_json::Value) {
        match self.queue.room(bytes) {
            Some(room) => {
                let (value, bytes) = (value(), bytes as u64);
                self.send(Event::Note(Note { topic, stamp_ns, value, bytes, _room: room }));
            }
            None => self.leave_out(),
        }
    }

    fn leave_out(&mut self) {
        if self.left_out == 0 {
            tracing::warn!("the disk is too slow for this session's recording: what does not fit is left out");
        }
        self.left_out += 1;
    }

    fn send_steps(&mut self) {
        while let Some(step) = self.steps.next() {
            self.send(Event::Step(Box::new(step)));
        }
    }

    /// The task ends before its recorder only if it broke; that was logged there.
    fn send(&self, event: Event) {
        let _ = self.events.send(event);
    }
}
