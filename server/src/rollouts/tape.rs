//! The recording of one running session: what is written down of it, and how much. Blocking code; whoever uses it does so away from the runtime.

use std::{collections::BTreeMap, time::Instant};

use gleaner_recording::TaskSpec;

use super::{
    about::{Place, Slip},
    event::{Ending, Note, Written, bytes},
    file::{Fault, Open},
};
use crate::error::{Error, Result};

/// Most that a step's or a note's messages take beside what they carry.
const STEP_BYTES: u64 = 1 << 10;
const NOTE_BYTES: u64 = 256;

/// What a recording may come to, so that the inspection and the uploads' limit will take it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Limits {
    /// Steps, by the memory that their images take once decoded.
    pub(super) steps: u64,
    pub(super) bytes: u64,
}

/// The recording of one session, while it is written.
pub(super) struct Tape {
    place: Place,
    slip: Slip,
    spec: TaskSpec,
    limits: Limits,
    /// Made with the first step, so that a session without any leaves nothing.
    file: Option<Open>,
    /// What came before the first step.
    early: Vec<Note>,
    steps: u64,
    /// Observations that do not fit the task.
    malformed: u64,
    /// Steps beyond the limits, or after the disk refused.
    beyond: u64,
    full: bool,
    /// The disk refused: what is on it up to then is what there is.
    broken: bool,
}

impl Tape {
    /// Nothing is on disk yet.
    pub(super) fn new(place: Place, slip: Slip, spec: TaskSpec, limits: Limits) -> Self {
        let (file, steps, malformed, beyond) = (None, 0, 0, 0);
        let (early, full, broken) = (Vec::new(), false, false);
        Self { place, slip, spec, limits, file, early, steps, malformed, beyond, full, broken }
    }

    /// When to sync next; `None` while there is nothing to.
    pub(super) fn sync_at(&self) -> Option<Instant> {
        self.file.as_ref().and_then(Open::sync_at)
    }

    /// Writes a step. What does not fit is left out and counted.
    pub(super) fn step(&mut self, step: &Written) {
        let size = bytes(&step.observation) as u64 + STEP_BYTES;
        if self.steps >= self.limits.steps || !self.has_room(size) {
            self.beyond += 1;
            self.warn_full();
            return;
        }
        let written = match self.open() {
            Ok(()) => self.file.as_mut().map_or(Ok(()), |file| file.step(&self.spec, step, size)),
            Err(error) => Err(Fault::Disk(error)),
        };
        match written {
            Ok(()) => self.steps += u64::from(step.action.is_some()),
            Err(Fault::Misfit(problem)) => self.misfit(&problem, step.observation.stamp_ns),
            Err(Fault::Disk(error)) => {
                self.beyond += 1;
                self.give_up(&error);
            }
        }
    }

    /// Writes something beside the steps. Before the first of them it waits: without any there is to be no file.
    pub(super) fn note(&mut self, note: Note) {
        let size = note.bytes + NOTE_BYTES;
        if !self.has_room(size) {
            self.beyond += 1;
            return;
        }
        let Some(file) = &mut self.file else { return self.early.push(note) };
        if let Err(error) = file.note(&note, size) {
            self.give_up(&error);
        }
    }

    /// Puts on disk what was written.
    pub(super) fn sync(&mut self) {
        let Some(file) = self.file.as_mut().filter(|_| !self.broken) else { return };
        if let Err(error) = file.sync() {
            self.give_up(&error);
        }
    }

    /// Writes nothing more: the disk is nearly full. What there is stays whole, and is kept.
    pub(super) fn stop(&mut self, why: &Error) {
        if !std::mem::replace(&mut self.full, true) {
            tracing::warn!(
                session.id = %self.slip.about.session_id, recording.steps = self.steps, error = %why,
                "a session goes on without its recording"
            );
        }
    }

    /// Ends the recording and says so on its slip. False when the session has left nothing.
    ///
    /// # Errors
    /// Internal when it could not even be begun, or the slip cannot be written.
    pub(super) fn end(mut self, ending: &Ending) -> Result<bool> {
        let Some(file) = self.file.take() else {
            self.place.remove()?;
            if self.broken {
                return Err(Error::internal("recording a session", "the disk refused its first step"));
            }
            return Ok(false);
        };
        self.slip.outcome = ending.outcome;
        if !self.broken {
            match file.finish(self.tally(ending)) {
                Ok(()) => self.slip.steps = Some(self.steps),
                Err(error) => self.give_up(&error),
            }
        }
        self.place.write(&self.slip)?;
        Ok(true)
    }

    /// Whether so many bytes more may be written. What is on disk is less than what came, so it is asked before the
    /// answer is no.
    fn has_room(&mut self, bytes: u64) -> bool {
        if self.full || self.broken {
            return false;
        }
        let limit = self.limits.bytes;
        let fits = |file: &Open| file.most().saturating_add(bytes) <= limit;
        if !self.file.as_ref().is_none_or(fits) {
            self.sync();
            if !self.file.as_ref().is_none_or(fits) {
                self.warn_full();
            }
        }
        !self.full && !self.broken
    }

    /// The first one is worth a warning: it may be that all are like it.
    fn misfit(&mut self, problem: &str, stamp_ns: i64) {
        if self.malformed == 0 {
            tracing::warn!(
                problem, observation.stamp_ns = stamp_ns, session.id = %self.slip.about.session_id,
                "an observation is not recorded; the others like it are counted"
            );
        } else {
            tracing::debug!(problem, observation.stamp_ns = stamp_ns, "an observation is not recorded");
        }
        self.malformed += 1;
    }

    fn tally(&self, ending: &Ending) -> BTreeMap<String, String> {
        let counts = [
            ("answered", ending.answered),
            ("dropped", ending.dropped),
            ("missed", ending.missed),
            ("steps", self.steps),
            ("left_out", ending.left_out + self.beyond),
            ("malformed", self.malformed),
        ];
        let unscored = ending.unscored.map(|count| ("unscored", count));
        let counts = counts.into_iter().chain(unscored).map(|(name, count)| (name.to_owned(), count.to_string()));
        counts.chain([("ended".to_owned(), ending.how.clone())]).collect()
    }

    /// Makes the file, if it is not there yet.
    fn open(&mut self) -> Result<()> {
        if self.file.is_none() {
            self.file = Some(Open::create(&self.place, &self.slip, &self.spec)?);
            std::mem::take(&mut self.early).into_iter().for_each(|note| self.note(note));
        }
        Ok(())
    }

    fn give_up(&mut self, error: &Error) {
        if !std::mem::replace(&mut self.broken, true) {
            tracing::error!(
                error = error as &dyn std::error::Error, session.id = %self.slip.about.session_id,
                "the disk refuses a session's recording; what is on it is kept, the rest is lost"
            );
        }
    }

    fn warn_full(&mut self) {
        if !self.broken && !std::mem::replace(&mut self.full, true) {
            tracing::warn!(
                session.id = %self.slip.about.session_id, recording.steps = self.steps,
                "a session is longer than a recording may be: the rest is left out. Close sessions between episodes, or \
                 raise --inspect-memory-bytes and --max-upload-bytes"
            );
        }
    }
}
