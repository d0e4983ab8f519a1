//! What a model's thread does: takes what waits, perhaps waits a little for more, and answers it together.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use tokio::sync::oneshot;

use super::{
    model::{Advanced, Model, Turn, answer},
    pace::Pace,
    stages::Stages,
    vigil::Vigil,
};
use crate::error::{Error, Result};

/// So many turns may share a pass however few others there are: fewer cost the model more each.
const LEAST_WAVE: usize = 4;

/// What came of asking.
#[derive(Debug)]
pub(super) enum Turned<H> {
    /// The model ran; perhaps past the deadline.
    Advanced(Advanced<H>),
    /// The deadline passed before the model was free: it did not run. The history comes back as it was.
    Late(Option<H>),
}

impl<H> Turned<H> {
    /// What the model gave.
    ///
    /// # Errors
    /// Late when it did not run in time.
    pub(super) fn advanced(self) -> Result<Advanced<H>> {
        match self {
            Self::Advanced(advanced) => Ok(advanced),
            Self::Late(_) => Err(Error::late("the deadline passed before the policy was free")),
        }
    }
}

/// A turn on its way to the model.
pub(super) struct Request<H> {
    pub(super) turn: Turn<H>,
    pub(super) stages: Arc<Stages>,
    /// When an answer is of no use any more.
    pub(super) deadline: Option<Instant>,
    /// When it came to the model's queue.
    pub(super) since: Instant,
    pub(super) reply: oneshot::Sender<Result<Turned<H>>>,
}

/// A model and those who wait for it.
pub(super) struct Server<M: Model> {
    pub(super) model: M,
    pub(super) waiting: flume::Receiver<Request<M::History>>,
    /// Most turns in one batch.
    pub(super) most: usize,
    pub(super) pace: Arc<Pace>,
    pub(super) vigil: Vigil,
    /// How long the model took last: what a deadline must leave it.
    pub(super) took: Duration,
    /// How many turns its last pass had.
    pub(super) last: usize,
}

impl<M: Model> Server<M> {
    /// Serves until nobody can ask any more.
    pub(super) fn run(mut self) {
        while let Some(first) = self.vigil.next(&self.waiting) {
            let free = Instant::now();
            let (mut batch, waited) = self.gather(first, free);
            batch.retain(|request| !request.reply.is_closed());
            let begun = Instant::now();
            let (late, batch): (Vec<_>, Vec<_>) =
                batch.into_iter().partition(|request| request.deadline.is_some_and(|deadline| deadline <= begun));
            for Request { turn, reply, .. } in late {
                // A caller that has gone needs no answer.
                let _ = reply.send(Ok(Turned::Late(turn.history)));
            }
            if batch.is_empty() {
                continue;
            }
            for request in &batch {
                let gathered = if waited { begun - free.max(request.since).min(begun) } else { Duration::ZERO };
                request.stages.enters(gathered, batch.len());
            }
            self.last = batch.len();
            serve(&self.model, batch);
            self.took = begun.elapsed();
        }
    }

    /// What waits, and what comes while every deadline and the fastest session can spare the time; and whether time
    /// was taken for that.
    fn gather(&self, first: Request<M::History>, free: Instant) -> (Vec<Request<M::History>>, bool) {
        let patience = self.pace.patience();
        // Not all who ask have a session.
        let here = |present: usize| present.max(1 + self.waiting.len());
        let most = patience.map_or(self.most, |(present, _)| self.most.min(wave(here(present))));
        let mut batch = vec![first];
        while batch.len() < most
            && let Ok(next) = self.waiting.try_recv()
        {
            batch.push(next);
        }
        let Some((present, wait)) = patience else {
            return (batch, false);
        };
        // Where there are two waves, those of the last one are not due.
        let due = if present > LEAST_WAVE { present.saturating_sub(self.last) } else { present };
        let mut waited = false;
        let mut until = free + wait;
        while batch.len() < due.min(most) {
            // Half of what a deadline leaves besides the model: a thread may wake late.
            let spare = |deadline: Instant| deadline.saturating_duration_since(free).saturating_sub(self.took) / 2;
            let tightest = batch.iter().filter_map(|request| request.deadline).map(spare).min();
            until = tightest.map_or(until, |tightest| until.min(free + tightest));
            waited = true;
            match self.waiting.recv_deadline(until) {
                Ok(next) => batch.push(next),
                Err(_) => break,
            }
        }
        (batch, waited)
    }
}

/// How many of those who are here share a pass at most: half, so that the others' observations come in and are decoded
/// while the model is busy, instead of both waiting for each other in turns.
fn wave(present: usize) -> usize {
    present.div_ceil(2).max(LEAST_WAVE)
}

/// Answers a batch. If it fails as a whole, each turn is tried alone, so that only the one at fault fails.
fn serve<M: Model>(model: &M, mut batch: Vec<Request<M::History>>) {
    let turns: Vec<_> = batch.iter().map(|request| &request.turn).collect();
    // Below, a caller that has gone meanwhile needs no answer.
    match answer(model, &turns) {
        Ok(advanced) => {
            for (request, advanced) in batch.into_iter().zip(advanced) {
                request.stages.leaves();
                let _ = request.reply.send(Ok(Turned::Advanced(advanced)));
            }
        }
        Err(error) if batch.len() > 1 => {
            tracing::warn!(%error, batch.turns = batch.len(), "a batch failed; answering its turns one by one");
            for request in batch {
                serve(model, vec![request]);
            }
        }
        Err(error) => {
            if let Some(alone) = batch.pop() {
                let _ = alone.reply.send(Err(error));
            }
        }
    }
}

#[cfg(test)]
mod tests;
