//! Work that consists of items, shared by ranks: each rank does a part of the items, and the results are those of one
//! process, in the order of the items. Ranks meet in rounds at short intervals, which carry progress, requests to stop and
//! failures. Independent of what an item is.

use std::fmt;
use std::time::{Duration, Instant};

use crate::error::LearnError;
use crate::peers::{Peers, Receivers};
use crate::progress::Progress;
use crate::train::Monitor;

/// Shortest interval between two rounds. A round waits for the rank with the longest item, so it is far longer than an
/// item, and short enough for progress and requests to stop.
#[cfg(not(test))]
const ROUND: Duration = Duration::from_millis(500);
#[cfg(test)]
const ROUND: Duration = Duration::ZERO;

/// A rank's state in a round.
#[derive(Clone, Copy, PartialEq, Eq)]
enum State {
    Working,
    /// Its items are done.
    Done,
    /// An item failed.
    Failed,
}

/// The form in which one kind of result goes from one rank to another: exact bytes.
pub struct Form<'a, T> {
    /// A result as bytes.
    pub write: &'a dyn Fn(&T) -> Result<Vec<u8>, LearnError>,
    /// The result of the item of this number; `None` if the bytes are not one.
    pub read: &'a dyn Fn(usize, &[u8]) -> Option<T>,
}

impl<T> fmt::Debug for Form<'_, T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Form").finish_non_exhaustive()
    }
}

/// The ranks of an attempt and its progress.
pub struct Shards<'a> {
    peers: &'a mut Peers,
    progress: Progress<'a>,
    /// Units done here since the last round.
    done: u64,
    last_round: Instant,
    /// Whether a round has ended the work with an error, which every rank has.
    ended: bool,
}

impl fmt::Debug for Shards<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Shards").field("peers", &self.peers).field("done", &self.done).finish_non_exhaustive()
    }
}

impl<'a> Shards<'a> {
    /// Work of `total` units, such as segments. `rate` names the metric of units for each second.
    #[must_use]
    pub fn new(peers: &'a mut Peers, monitor: &'a mut dyn Monitor, total: u64, rate: Option<&'static str>) -> Self {
        Self { peers, progress: Progress::new(monitor, total, rate), done: 0, last_round: Instant::now(), ended: false }
    }

    /// Whether this rank has the result.
    pub(crate) fn lead(&self) -> bool {
        self.peers.lead()
    }

    /// The items that this rank does, in the order in which it does them.
    pub(crate) fn own(&self, sizes: &[usize]) -> Vec<usize> {
        divide(sizes, self.peers.ranks()).into_iter().nth(self.peers.rank()).unwrap_or_default()
    }

    /// Counts units that are done, reports them at intervals, and checks for cancellation.
    ///
    /// # Errors
    /// [`LearnError::Cancelled`]; when another rank fails or is lost.
    pub fn advance(&mut self, units: usize) -> Result<(), LearnError> {
        if !self.peers.several() {
            return self.progress.advance(units);
        }
        self.done += units as u64;
        if self.last_round.elapsed() >= ROUND { self.round(State::Working, None).map(drop) } else { Ok(()) }
    }

    /// Reports that all units are done, without a round.
    pub(crate) fn finish(&mut self) -> Result<(), LearnError> {
        if self.peers.lead() { self.progress.finish() } else { Ok(()) }
    }

    /// The results of `act` for all items, whose sizes are given, at every rank.
    pub(crate) fn all<T>(
        &mut self,
        sizes: &[usize],
        form: &Form<'_, T>,
        act: impl FnMut(&mut Self, usize) -> Result<T, LearnError>,
    ) -> Result<Vec<T>, LearnError> {
        self.share(sizes, (form, Receivers::All), act)?.into_iter().collect::<Option<_>>().ok_or(LearnError::Exchange)
    }

    /// The results of `act` for all items, whose sizes are given, at rank 0, which does the first item; `None` at the
    /// others.
    ///
    /// # Errors
    /// Those of `act`, at every rank; when another rank is lost; [`LearnError::Cancelled`].
    pub fn at_lead<T>(
        &mut self,
        sizes: &[usize],
        form: &Form<'_, T>,
        act: impl FnMut(&mut Self, usize) -> Result<T, LearnError>,
    ) -> Result<Option<Vec<T>>, LearnError> {
        let results = self.share(sizes, (form, Receivers::Lead), act)?;
        if !self.peers.lead() {
            return Ok(None);
        }
        results.into_iter().collect::<Option<_>>().ok_or(LearnError::Exchange).map(Some)
    }

    /// The results that this rank has: its own, and what it received.
    fn share<T>(
        &mut self,
        sizes: &[usize],
        (form, receivers): (&Form<'_, T>, Receivers),
        mut act: impl FnMut(&mut Self, usize) -> Result<T, LearnError>,
    ) -> Result<Vec<Option<T>>, LearnError> {
        if !self.peers.several() {
            return (0..sizes.len()).map(|item| act(self, item).map(Some)).collect();
        }
        let parts = divide(sizes, self.peers.ranks());
        let own = parts.get(self.peers.rank()).map(Vec::as_slice).unwrap_or_default();
        let mut results: Vec<Option<T>> = sizes.iter().map(|_| None).collect();
        for item in own {
            results[*item] = match act(self, *item) {
                Ok(result) => Some(result),
                Err(error) => return Err(self.fail(error)),
            };
        }
        while !self.round(State::Done, None)? {}
        let mut bytes = Vec::new();
        if receivers == Receivers::All || !self.peers.lead() {
            for result in own.iter().filter_map(|item| results[*item].as_ref()) {
                let result = (form.write)(result)?;
                bytes.extend_from_slice(&(result.len() as u64).to_le_bytes());
                bytes.extend_from_slice(&result);
            }
        }
        let mut awaited: Vec<_> = parts.iter().map(|part| part.iter()).collect();
        let mut rest = Vec::new();
        self.peers.exchange(&bytes, receivers, |sender, piece| {
            rest.extend_from_slice(piece);
            let mut begin = 0;
            while let Some(result) = first(&rest[begin..]) {
                let item = *awaited[sender].next().ok_or(LearnError::Exchange)?;
                results[item] = Some((form.read)(item, result).ok_or(LearnError::Exchange)?);
                begin += LENGTH + result.len();
            }
            rest.drain(..begin);
            Ok(())
        })?;
        Ok(results)
    }

    /// Ends the work at every rank with the error of an item here; an error that ends this process is noticed by the
    /// others.
    fn fail(&mut self, error: LearnError) -> LearnError {
        if self.ended || portable(&error).is_none() {
            return error;
        }
        match self.round(State::Failed, Some(&error)) {
            Ok(_) => error,
            Err(error) => error,
        }
    }

    /// Meets the other ranks; returns whether all are done.
    fn round(&mut self, state: State, error: Option<&LearnError>) -> Result<bool, LearnError> {
        let flag = |wanted| u64::from(state == wanted);
        let stop = u64::from(self.progress.cancelled());
        self.ended = true;
        let counts = [self.done, flag(State::Done), flag(State::Failed), stop];
        let [units, done, failed, stop] = self.peers.sum_counts(counts)?;
        if stop > 0 {
            return Err(LearnError::Cancelled);
        }
        if failed > 0 {
            return Err(self.first_failure(error)?);
        }
        self.ended = false;
        if self.peers.lead() {
            self.progress.report(units);
        }
        (self.done, self.last_round) = (0, Instant::now());
        Ok(done == self.peers.ranks() as u64)
    }

    /// The error of the first rank that has one.
    fn first_failure(&mut self, error: Option<&LearnError>) -> Result<LearnError, LearnError> {
        let own = error.and_then(portable).unwrap_or_default();
        let mut failures = vec![Vec::new(); self.peers.ranks()];
        failures[self.peers.rank()].clone_from(&own);
        self.peers.exchange(&own, Receivers::All, |sender, piece| {
            failures[sender].extend_from_slice(piece);
            Ok(())
        })?;
        failures.iter().find_map(|bytes| from_portable(bytes)).ok_or(LearnError::Exchange)
    }
}

/// Bytes of the length before each result.
const LENGTH: usize = 8;

/// The first result of `bytes`; `None` if it is incomplete.
fn first(bytes: &[u8]) -> Option<&[u8]> {
    let (length, rest) = bytes.split_first_chunk::<LENGTH>()?;
    rest.get(..usize::try_from(u64::from_le_bytes(*length)).ok()?)
}

/// An error that every attempt would meet, as bytes.
fn portable(error: &LearnError) -> Option<Vec<u8>> {
    let parts = match error {
        LearnError::Invalid { field, message } => (Some(field), message),
        LearnError::Checkpoint(message) => (None, message),
        LearnError::Version { .. }
        | LearnError::Cancelled
        | LearnError::Diverged { .. }
        | LearnError::Monitor { .. }
        | LearnError::Steps { .. }
        | LearnError::Thread(_)
        | LearnError::Group(_)
        | LearnError::Exchange
        | LearnError::Torch(_) => return None,
    };
    serde_json::to_vec(&parts).ok()
}

fn from_portable(bytes: &[u8]) -> Option<LearnError> {
    let (field, message): (Option<String>, String) = serde_json::from_slice(bytes).ok()?;
    Some(match field {
        Some(field) => LearnError::Invalid { field, message },
        None => LearnError::Checkpoint(message),
    })
}

/// The items of each rank, in rising order, so that the ranks' sums of sizes are about equal.
fn divide(sizes: &[usize], ranks: usize) -> Vec<Vec<usize>> {
    let mut parts = vec![(0, Vec::new()); ranks];
    for (item, size) in sizes.iter().enumerate() {
        if let Some((sum, part)) = parts.iter_mut().min_by_key(|(sum, _)| *sum) {
            *sum += size;
            part.push(item);
        }
    }
    parts.into_iter().map(|(_, part)| part).collect()
}

#[cfg(test)]
mod tests;
