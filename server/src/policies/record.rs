//! A session's side channels: its recording, its live scores and its entry for the pages. None of them delays the
//! session.

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
    rollouts::{ObservationCounts, Recorder},
    scorers::{DecodedObservation, Scorer, Watch},
};

/// A session's recorder, if it is recorded, and its entry for the pages.
pub(super) struct Record {
    recorder: Option<Recorder>,
    showing: Showing,
}

impl Record {
    pub(super) fn new(recorder: Option<Recorder>, showing: Showing) -> Self {
        Self { recorder, showing }
    }

    /// Passes on an observation and checks what a recording additionally requires.
    ///
    /// # Errors
    /// Invalid for a stamp that a recording cannot hold.
    pub(super) fn observed(&mut self, observation: &Observation, before_ns: Option<i64>) -> Result<()> {
        self.showing.saw(observation);
        let Some(recorder) = &mut self.recorder else { return Ok(()) };
        let stamp_ns = observation.stamp_ns;
        if stamp_ns < 0 || before_ns == Some(stamp_ns) {
            let fix = format!(
                "is {stamp_ns}; stamps of a recorded session must be at least 0 and rise with each observation"
            );
            return Err(Error::invalid("observation.stamp_ns", fix));
        }
        recorder.observed(observation);
        Ok(())
    }

    /// The observation of this stamp was passed to the model.
    pub(super) fn inference_started(&mut self, stamp_ns: i64) {
        if let Some(recorder) = &mut self.recorder {
            recorder.inference_started(stamp_ns);
        }
    }

    /// The model returned; `sound`: the observation was decoded.
    pub(super) fn inference_finished(&mut self, sound: bool) {
        if let Some(recorder) = &mut self.recorder {
            recorder.inference_finished(sound);
        }
    }

    /// These actions were sent to the robot.
    pub(super) fn commanded(&mut self, acted: &Acted) {
        self.showing.answered(&acted.timings);
        if let Some(recorder) = &mut self.recorder {
            recorder.commanded(acted);
        }
    }

    /// Passes on new scores and returns the newest.
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

    /// Ends a session that its robot closed; waits until its episode is stored.
    ///
    /// # Errors
    /// When the episode cannot be stored.
    pub(super) async fn close(
        &mut self,
        outcome: Outcome,
        how: &str,
        counts: ObservationCounts,
    ) -> Result<Option<EpisodeId>> {
        match self.recorder.take() {
            Some(recorder) => recorder.finish(outcome, how, counts).await,
            None => Ok(None),
        }
    }

    /// Ends a session that failed; its episode is stored in the background.
    pub(super) fn break_off(&mut self, error: &Error, counts: ObservationCounts) {
        if let Some(recorder) = self.recorder.take() {
            // The receiver is not awaited: the episode is stored in the background.
            drop(recorder.end(Outcome::Unknown, &error.to_string(), counts));
        }
    }

    pub(super) fn is_on(&self) -> bool {
        self.recorder.is_some()
    }
}

/// Passes to the live scorer the step that the model is about to see. Segments across a gap are not scored: experts
/// have none.
pub(super) fn show<S: Scorer>(watch: &mut Watch<S>, stamp_ns: i64, step: &Step, gap: bool) {
    match &step.executed {
        _ if gap => watch.gap(),
        Some(executed) => watch.executed(executed),
        None => {}
    }
    let frames = Bytes::copy_from_slice(&step.frame);
    watch.saw(DecodedObservation { stamp_ns, frames, proprioception: step.proprioception.clone() });
}
