//! Writes the recording of one running session within its limits. Blocking code, to be called off the runtime.

use std::{collections::BTreeMap, time::Instant};

use gleaner_recording::TaskSpec;

use super::{
    event::{Ending, Note, Written, bytes},
    file::{Fault, Open},
    sidecar::{RolloutFiles, RolloutSidecar},
};
use crate::{
    domain::episode::Outcome,
    error::{Error, Result},
};

/// The most bytes of a step's or a note's messages beside their payload.
const STEP_BYTES: u64 = 1 << 10;
const NOTE_BYTES: u64 = 256;

/// Limits of a recording, so that its inspection and the upload limit accept it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Limits {
    /// Steps, by the memory that their inspection needs.
    pub(super) steps: u64,
    pub(super) bytes: u64,
}

/// The recording of one session while it is written.
pub(super) struct RolloutWriter {
    files: RolloutFiles,
    sidecar: RolloutSidecar,
    spec: TaskSpec,
    limits: Limits,
    /// Created with the first step, so that a session without steps leaves no file.
    file: Option<Open>,
    /// Notes before the first step.
    early: Vec<Note>,
    steps: u64,
    /// Observations that do not fit the task.
    malformed: u64,
    /// Steps beyond the limits, or after an error of the disk.
    beyond: u64,
    full: bool,
    /// An error of the disk ended the recording; the part written before it is kept.
    broken: bool,
}

impl RolloutWriter {
    /// No file is created yet.
    pub(super) fn new(files: RolloutFiles, sidecar: RolloutSidecar, spec: TaskSpec, limits: Limits) -> Self {
        let (file, steps, malformed, beyond) = (None, 0, 0, 0);
        let (early, full, broken) = (Vec::new(), false, false);
        Self { files, sidecar, spec, limits, file, early, steps, malformed, beyond, full, broken }
    }

    /// When to sync next; `None` while everything is synced.
    pub(super) fn sync_at(&self) -> Option<Instant> {
        self.file.as_ref().and_then(Open::sync_at)
    }

    /// Writes a step. Steps that do not fit the task or the limits are left out and counted.
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

    /// Writes a note. Before the first step it is held back: a session without steps leaves no file.
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

    /// Syncs the file.
    pub(super) fn sync(&mut self) {
        let Some(file) = self.file.as_mut().filter(|_| !self.broken) else { return };
        if let Err(error) = file.sync() {
            self.give_up(&error);
        }
    }

    /// Stops writing because the disk is nearly full. The part written so far is kept.
    pub(super) fn stop(&mut self, why: &Error) {
        if !std::mem::replace(&mut self.full, true) {
            tracing::warn!(
                session.id = %self.sidecar.session.session_id, recording.steps = self.steps, error = %why,
                "the session continues without its recording"
            );
        }
    }

    /// Ends the recording and its sidecar. False when the session has no file.
    ///
    /// # Errors
    /// Internal when the file could not be created, or the sidecar cannot be written.
    pub(super) fn end(mut self, ending: &Ending) -> Result<bool> {
        let Some(file) = self.file.take() else {
            self.files.remove()?;
            if self.broken {
                return Err(Error::internal("recording a session", "the disk rejected its first step"));
            }
            return Ok(false);
        };
        if !self.broken {
            match file.finish(self.counts(ending)) {
                Ok(()) => self.sidecar.steps = Some(self.steps),
                Err(error) => self.give_up(&error),
            }
        }
        self.sidecar.outcome = self.outcome(ending);
        self.files.write(&self.sidecar)?;
        Ok(true)
    }

    /// The outcome of the episode. A success whose recording lacks steps or notes becomes unknown, because snapshots would
    /// take it for an expert.
    fn outcome(&self, ending: &Ending) -> Outcome {
        let left_out = self.left_out(ending);
        if ending.outcome != Outcome::Success || (left_out == 0 && !self.broken) {
            return ending.outcome;
        }
        tracing::warn!(
            session.id = %self.sidecar.session.session_id, recording.steps = self.steps, recording.left_out = left_out,
            "a session ended as a success, but its recording lacks steps or notes; its outcome is stored as unknown"
        );
        Outcome::Unknown
    }

    /// Steps and notes that are not in the recording for lack of room.
    fn left_out(&self, ending: &Ending) -> u64 {
        ending.left_out + self.beyond
    }

    /// Whether this many more bytes fit. The size is an upper bound, so the file is synced and measured before the
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

    /// Warns about the first one only: all may be alike.
    fn misfit(&mut self, problem: &str, stamp_ns: i64) {
        if self.malformed == 0 {
            tracing::warn!(
                problem, observation.stamp_ns = stamp_ns, session.id = %self.sidecar.session.session_id,
                "an observation is not recorded; further ones are counted"
            );
        } else {
            tracing::debug!(problem, observation.stamp_ns = stamp_ns, "an observation is not recorded");
        }
        self.malformed += 1;
    }

    fn counts(&self, ending: &Ending) -> BTreeMap<String, String> {
        let counts = [
            ("answered", ending.answered),
            ("dropped", ending.dropped),
            ("missed", ending.missed),
            ("steps", self.steps),
            ("left_out", self.left_out(ending)),
            ("malformed", self.malformed),
        ];
        let unscored = ending.unscored.map(|count| ("unscored", count));
        let counts = counts.into_iter().chain(unscored).map(|(name, count)| (name.to_owned(), count.to_string()));
        let outcome = ending.outcome.as_str().to_owned();
        counts.chain([("ended".to_owned(), ending.how.clone()), ("outcome".to_owned(), outcome)]).collect()
    }

    /// Creates the file if it does not exist yet.
    fn open(&mut self) -> Result<()> {
        if self.file.is_none() {
            self.file = Some(Open::create(&self.files, &self.sidecar, &self.spec)?);
            std::mem::take(&mut self.early).into_iter().for_each(|note| self.note(note));
        }
        Ok(())
    }

    fn give_up(&mut self, error: &Error) {
        if !std::mem::replace(&mut self.broken, true) {
            tracing::error!(
                error = error as &dyn std::error::Error, session.id = %self.sidecar.session.session_id,
                "writing a session's recording failed; the part on disk is kept, the rest is lost"
            );
        }
    }

    fn warn_full(&mut self) {
        if !self.broken && !std::mem::replace(&mut self.full, true) {
            tracing::warn!(
                session.id = %self.sidecar.session.session_id, recording.steps = self.steps,
                "a session exceeds the limits of a recording; the rest is left out. Close sessions between episodes, or \
                 raise --inspect-memory-bytes and --max-upload-bytes"
            );
        }
    }
}
