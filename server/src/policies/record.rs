//! What goes along with a session beside its policy: its recording, its live score and what is shown of it. None holds
//! the session up.

use bytes::Bytes;

use super::{live::Showing, model::Step};
use crate::{
    domain::{
        episode::Outcome,
        id::EpisodeId,
        observation::{Acted, Observation},
        score::SegmentScored,
    },
    error::{Error, Result},
    rollouts::{Recorder, Tally},
    scorers::{Scorer, Seen, Watch},
};

/// A session's recording, if it asked for one, and what is shown of it.
pub(super) struct Record {
    recorder: Option<Recorder>,
    showing: Showing,
}

impl Record {
    pub(super) fn new(recorder: Option<Recorder>, showing: Showing) -> Self {
        Self { recorder, showing }
    }

    /// An observation has come. What a recording needs beyond what a session needs is asked for here.
    ///
    /// # Errors
    /// Invalid for a stamp that no recording can have.
    pub(super) fn observed(&mut self, observation: &Observation, before_ns: Option<i64>) -> Result<()> {
        self.showing.saw(observation);
        let Some(recorder) = &mut self.recorder else { return Ok(()) };
        let stamp_ns = observation.stamp_ns;
        if stamp_ns < 0 || before_ns == Some(stamp_ns) {
            let mend =
                format!("is {stamp_ns}; in a recorded session stamps are not below 0 and rise with each observation");
            return Err(Error::invalid("observation.stamp_ns", mend));
        }
        recorder.observed(observation);
        Ok(())
    }

    /// The observation of this stamp goes to the model.
    pub(super) fn asks(&mut self, stamp_ns: i64) {
        if let Some(recorder) = &mut self.recorder {
            recorder.asks(stamp_ns);
        }
    }

    /// What the model had is back; `sound` says that it was decoded.
    pub(super) fn turned(&mut self, sound: bool) {
        if let Some(recorder) = &mut self.recorder {
            recorder.turned(sound);
        }
    }

    /// The robot was given these actions.
    pub(super) fn commanded(&mut self, acted: &Acted) {
        self.showing.answered(&acted.timings);
        if let Some(recorder) = &mut self.recorder {
            recorder.commanded(acted);
        }
    }

    /// Takes what has been scored meanwhile; gives the newest.
    pub(super) fn scored(&mut self, watch: Option<&mut Watch>) -> Option<SegmentScored> {
        let watch = watch?;
        for scored in watch.take_scored() {
            self.showing.scored(&scored);
            if let Some(recorder) = &mut self.recorder {
                recorder.scored(&scored);
            }
        }
        watch.newest()
    }

    /// The session is over as its robot wished; waits until its episode is stored.
    ///
    /// # Errors
    /// When it cannot be kept.
    pub(super) async fn close(&mut self, outcome: Outcome, how: &str, tally: Tally) -> Result<Option<EpisodeId>> {
        match self.recorder.take() {
            Some(recorder) => recorder.finish(outcome, how, tally).await,
            None => Ok(None),
        }
    }

    /// The session is over by an error; its episode is stored in its own time.
    pub(super) fn break_off(&mut self, error: &Error, tally: Tally) {
        if let Some(recorder) = self.recorder.take() {
            // Nobody waits for it.
            drop(recorder.end(Outcome::Unknown, &error.to_string(), tally));
        }
    }

    pub(super) fn is_on(&self) -> bool {
        self.recorder.is_some()
    }
}

/// Shows a watch the step that the model is about to see. Over a gap nothing is scored: experts have none.
pub(super) fn show<S: Scorer>(watch: &mut Watch<S>, stamp_ns: i64, step: &Step, gap: bool) {
    match &step.executed {
        _ if gap => watch.gap(),
        Some(executed) => watch.executed(executed),
        None => {}
    }
    let frames = Bytes::copy_from_slice(&step.frame);
    watch.saw(Seen { stamp_ns, frames, proprioception: step.proprioception.clone() });
}
