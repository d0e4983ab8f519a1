//! The loop of a model's thread: collect waiting requests into a micro-batch, run the model once, reply to each.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use tokio::sync::oneshot;

use super::{
    model::{Advanced, Model, ModelInput, answer},
    session_rates::SessionRates,
    spin_wait::SpinWait,
    stages::Stages,
};
use crate::error::{Error, Result};

/// The smallest cap of a micro-batch: smaller batches cost the model more per request.
const MIN_MICRO_BATCH: usize = 4;

/// The result of an inference request.
#[derive(Debug)]
pub(super) enum StepResult<H> {
    /// The model ran, perhaps past the deadline.
    Advanced(Advanced<H>),
    /// The deadline passed before the model was free. The model did not run; the history is returned unchanged.
    Late(Option<H>),
    /// The policy's own server did not answer; a later request may succeed. The history is returned unchanged.
    Unanswered(Option<H>, Error),
}

impl<H> StepResult<H> {
    /// The model's output.
    ///
    /// # Errors
    /// Late when the model did not run in time.
    pub(super) fn advanced(self) -> Result<Advanced<H>> {
        match self {
            Self::Advanced(advanced) => Ok(advanced),
            Self::Late(_) => Err(Error::late("the deadline passed before the policy was free")),
            Self::Unanswered(_, error) => Err(error),
        }
    }
}

/// An input in the queue of the model's thread.
pub(super) struct QueuedRequest<H> {
    pub(super) input: ModelInput<H>,
    pub(super) stages: Arc<Stages>,
    /// After this, a reply is useless.
    pub(super) deadline: Option<Instant>,
    /// When the request entered the queue.
    pub(super) since: Instant,
    pub(super) reply: oneshot::Sender<Result<StepResult<H>>>,
}

/// A model, its queue and its batching rules.
pub(super) struct Server<M: Model> {
    pub(super) model: M,
    pub(super) waiting: flume::Receiver<QueuedRequest<M::History>>,
    /// The most inputs in one batch.
    pub(super) most: usize,
    pub(super) rates: Arc<SessionRates>,
    pub(super) spin_wait: SpinWait,
    /// The duration of the last pass, reserved before each deadline.
    pub(super) took: Duration,
    /// The number of inputs in the last pass.
    pub(super) last: usize,
}

impl<M: Model> Server<M> {
    /// Serves until every sender of requests is dropped.
    pub(super) fn run(mut self) {
        while let Some(first) = self.spin_wait.next(&self.waiting) {
            let Some(first) = self.predicting(first) else { continue };
            let free = Instant::now();
            let (mut batch, waited) = self.gather(first, free);
            batch.retain(|request| !request.reply.is_closed());
            let begun = Instant::now();
            let (late, batch): (Vec<_>, Vec<_>) =
                batch.into_iter().partition(|request| request.deadline.is_some_and(|deadline| deadline <= begun));
            for QueuedRequest { input, reply, .. } in late {
                // The caller may be gone.
                let _ = reply.send(Ok(StepResult::Late(input.history)));
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

    /// Answers a request that needs no pass at once, so that it waits for no other one and the time of passes is not
    /// mistaken; returns any other.
    fn predicting(&self, request: QueuedRequest<M::History>) -> Option<QueuedRequest<M::History>> {
        let late = request.deadline.is_some_and(|deadline| deadline <= Instant::now());
        if late || self.model.predicts(&request.input) {
            return Some(request);
        }
        request.stages.enters(Duration::ZERO, 1);
        serve(&self.model, vec![request]);
        None
    }

    /// Returns the waiting requests, plus those that arrive within the time that every deadline and the fastest session
    /// can spare; and whether any time was spent waiting.
    fn gather(&self, first: QueuedRequest<M::History>, free: Instant) -> (Vec<QueuedRequest<M::History>>, bool) {
        let patience = self.rates.patience();
        // Callers without a session are not counted in the session rates.
        let here = |present: usize| present.max(1 + self.waiting.len());
        let most = patience.map_or(self.most, |(present, _)| self.most.min(micro_batch(here(present))));
        let (mut batch, mut answered) = (vec![first], 0);
        while batch.len() < most
            && let Ok(next) = self.waiting.try_recv()
        {
            match self.predicting(next) {
                Some(next) => batch.push(next),
                None => answered += 1,
            }
        }
        let Some((present, wait)) = patience else {
            return (batch, false);
        };
        // With two micro-batches in flight, sessions of the last one are not expected yet.
        let expected = if present > MIN_MICRO_BATCH { present.saturating_sub(self.last) } else { present };
        let mut waited = false;
        let mut until = free + wait;
        while batch.len() < most && batch.len() + answered < expected {
            // Half of what a deadline leaves after the model's time: a thread may wake late.
            let spare = |deadline: Instant| deadline.saturating_duration_since(free).saturating_sub(self.took) / 2;
            let tightest = batch.iter().filter_map(|request| request.deadline).map(spare).min();
            until = tightest.map_or(until, |tightest| until.min(free + tightest));
            waited = true;
            match self.waiting.recv_deadline(until) {
                Ok(next) => match self.predicting(next) {
                    Some(next) => batch.push(next),
                    None => answered += 1,
                },
                Err(_) => break,
            }
        }
        (batch, waited)
    }
}

/// The cap of a micro-batch: half of the present sessions, so that the other half's observations arrive and are decoded
/// while the model is busy.
fn micro_batch(present: usize) -> usize {
    present.div_ceil(2).max(MIN_MICRO_BATCH)
}

/// Answers a batch. If the batch fails, each input is run alone, so that only the faulty one fails.
fn serve<M: Model>(model: &M, mut batch: Vec<QueuedRequest<M::History>>) {
    let inputs: Vec<_> = batch.iter().map(|request| &request.input).collect();
    // Below, a caller that is gone needs no reply.
    match answer(model, &inputs) {
        Ok(advanced) => {
            for (request, advanced) in batch.into_iter().zip(advanced) {
                request.stages.leaves();
                let _ = request.reply.send(Ok(StepResult::Advanced(advanced)));
            }
        }
        Err(error) if batch.len() > 1 => {
            tracing::warn!(%error, batch.inputs = batch.len(), "a batch failed; running its inputs one by one");
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
