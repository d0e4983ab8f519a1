//! A session's end of its recording. It never waits: events without room in the queue are left out and counted.

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

/// Topics of the policy's chunks and the segments' scores. No mapping reads them.
const COMMANDS: &str = "/policy/action";
const SCORES: &str = "/policy/score";
/// The most bytes of a number as text.
const NUMBER_BYTES: usize = 24;

/// Counts of a session's observations: answered, dropped, and missed their deadline.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct ObservationCounts {
    pub(crate) answered: u64,
    pub(crate) dropped: u64,
    pub(crate) missed: u64,
    /// Segments that were to be scored and could not be; `None`: not counted.
    pub(crate) unscored: Option<u64>,
}

/// Records one session. Dropping it stores the steps so far with an unknown outcome.
pub(crate) struct Recorder {
    events: mpsc::UnboundedSender<Event>,
    queue: Queue,
    steps: Steps<super::event::QueuePermit>,
    left_out: u64,
}

impl Recorder {
    pub(super) fn new(events: mpsc::UnboundedSender<Event>, action_size: usize) -> Self {
        Self { events, queue: Queue::new(), steps: Steps::new(action_size), left_out: 0 }
    }

    /// Records an observation, whether or not it is answered.
    pub(crate) fn observed(&mut self, observation: &Observation) {
        let room = self.queue.room(bytes(observation));
        if room.is_none() {
            self.leave_out();
        }
        self.steps.observe(observation, room);
        self.send_steps();
    }

    /// The observation of this stamp was passed to the model.
    pub(crate) fn inference_started(&mut self, stamp_ns: i64) {
        self.steps.inference_started(stamp_ns);
    }

    /// The model returned; `sound`: the observation was decoded.
    pub(crate) fn inference_finished(&mut self, sound: bool) {
        self.steps.inference_finished(sound);
        self.send_steps();
    }

    /// Records the actions sent to the robot.
    pub(crate) fn commanded(&mut self, acted: &Acted) {
        if let Some(first) = acted.actions.first() {
            self.steps.does(first);
        }
        let value = || json!({"observation_stamp_ns": acted.stamp_ns, "actions": acted.actions});
        let numbers = acted.actions.iter().map(Vec::len).sum::<usize>();
        self.note(COMMANDS, acted.stamp_ns, numbers * NUMBER_BYTES, value);
    }

    /// Records the score of a segment.
    pub(crate) fn scored(&mut self, scored: &SegmentScored) {
        let SegmentScored { stamp_ns, w, q, match_episode, match_step } = scored;
        let value = || json!({"w": w, "q": q, "match_episode_id": match_episode.as_str(), "match_step": match_step});
        self.note(SCORES, *stamp_ns, 128, value);
    }

    /// Ends the recording and waits until the episode is stored; `None` when it is too short.
    ///
    /// # Errors
    /// When the recording cannot be stored: the server's log names its file.
    pub(crate) async fn finish(
        self,
        outcome: Outcome,
        how: &str,
        counts: ObservationCounts,
    ) -> Result<Option<EpisodeId>> {
        let lost = || Error::internal("keeping a recording", "its task ended early");
        self.end(outcome, how, counts).await.map_err(|_| lost())?
    }

    /// Ends the recording; it is stored in the background.
    pub(crate) fn end(
        mut self,
        outcome: Outcome,
        how: &str,
        counts: ObservationCounts,
    ) -> oneshot::Receiver<Result<Option<EpisodeId>>> {
        self.steps.end();
        self.send_steps();
        let ObservationCounts { answered, dropped, missed, unscored } = counts;
        let ending =
            Ending { outcome, how: how.to_owned(), answered, dropped, missed, unscored, left_out: self.left_out };
        let (done, stored) = oneshot::channel();
        self.send(Event::End(ending, done));
        stored
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
            tracing::warn!("the disk is too slow for this session's recording: steps are left out");
        }
        self.left_out += 1;
    }

    fn send_steps(&mut self) {
        while let Some(step) = self.steps.next() {
            self.send(Event::Step(Box::new(step)));
        }
    }

    /// The task ends before its recorder only after an error, which it has logged.
    fn send(&self, event: Event) {
        let _ = self.events.send(event);
    }
}
