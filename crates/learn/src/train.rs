//! The training loop that pretraining and policies share: step, report, checkpoint, resume. Independent of the loss.

mod monitor;
mod sums;
mod unread;

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use tch::{Device, Tensor};

use crate::ahead::{Assembled, Next, ahead, waiting};
use crate::checkpoint::{self, CheckpointInfo};
use crate::device::Tf32;
use crate::error::LearnError;
use crate::finished::Finished;
use crate::model::Network;
use crate::optimizer::AdamW;
use crate::peers::Peers;
use crate::precision;
use crate::validation;
use gleaner_core::OptimSpec;
use sums::Sums;
use unread::{Step, Unread};

pub use monitor::{Monitor, Participant, Silent};
pub(crate) use sums::Metrics;

/// The name of the loss on episodes that are held out.
pub(crate) const LOSS_VALIDATION: &str = "loss_validation";

/// The loss of one batch, or a rank's share of it: the ranks' values add up to those of one process.
pub(crate) struct Loss {
    /// The scalar to minimise.
    pub(crate) total: Tensor,
    /// Its terms, scalars, for the metrics.
    pub(crate) parts: Vec<(&'static str, Tensor)>,
}

/// A model that the loop trains.
pub(crate) trait Learner: Sized {
    /// The learner that `info` describes, with the weights in `named`.
    fn from_named(
        info: &CheckpointInfo,
        named: &BTreeMap<String, Tensor>,
        device: tch::Device,
    ) -> Result<Self, LearnError>;

    /// Every parameter in name order.
    fn parameters(&self) -> Vec<(String, Tensor)>;

    /// All values of a finished checkpoint: parameters and statistics.
    fn named(&self) -> Vec<(String, Tensor)>;
}

impl Learner for Network {
    fn from_named(
        info: &CheckpointInfo,
        named: &BTreeMap<String, Tensor>,
        device: tch::Device,
    ) -> Result<Self, LearnError> {
        Network::from_named(&info.shape, info.model, named, device)
    }

    fn parameters(&self) -> Vec<(String, Tensor)> {
        Network::parameters(self)
    }

    fn named(&self) -> Vec<(String, Tensor)> {
        Network::named(self)
    }
}

/// A learner in training: the transformer, except for policies of another kind.
pub(crate) struct Training<N = Network> {
    network: N,
    optimizer: AdamW,
    finished: Finished,
    optim: OptimSpec,
    /// The header of the next checkpoint; its `step` is the counter.
    info: CheckpointInfo,
    unread: Unread,
}

/// Result of resuming from a checkpoint.
pub(crate) enum Resumed<N = Network> {
    /// The run continues from here.
    Unfinished(Box<Training<N>>),
    /// The run was finished: its result.
    Finished(Vec<u8>),
}

impl<N: Learner> Training<N> {
    /// A training from the first step; `info` describes the run.
    pub(crate) fn start(network: N, info: CheckpointInfo, optim: &OptimSpec) -> Self {
        let (optimizer, finished) = (AdamW::new(network.parameters()), Finished::new(optim, network.parameters()));
        let device = optimizer.parameters().next().map_or(Device::Cpu, Tensor::device);
        Self { optimizer, finished, optim: *optim, network, info, unread: Unread::on(device) }
    }

    /// A training from a checkpoint of the run that `info` describes.
    pub(crate) fn resume(
        bytes: &[u8],
        info: &CheckpointInfo,
        optim: &OptimSpec,
        device: tch::Device,
    ) -> Result<Resumed<N>, LearnError> {
        let (stored, named) = checkpoint::read(bytes, info.kind)?;
        let same = [
            ("spec", stored.is_of_the_run_of(info)),
            ("shape", stored.shape == info.shape),
            ("model", stored.model == info.model),
        ];
        if let Some((field, _)) = same.iter().find(|(_, same)| !same) {
            return Err(LearnError::invalid(
                *field,
                "differs from the run the checkpoint is of; resume with the same settings or start from the beginning",
            ));
        }
        if stored.finished {
            return Ok(Resumed::Finished(bytes.to_vec()));
        }
        let network = N::from_named(&stored, &named, device)?;
        // The header of this program: that of an earlier one lacks settings.
        let info = CheckpointInfo { step: stored.step, ..info.clone() };
        let mut training = Self::start(network, info, optim);
        training.optimizer.load(&named)?;
        training.finished.load(&named)?;
        Ok(Resumed::Unfinished(Box::new(training)))
    }

    /// The learner.
    pub(crate) fn network(&self) -> &N {
        &self.network
    }

    /// Takes the remaining steps and returns the finished checkpoint, without optimiser state; `None` for a rank that does
    /// not lead. Each of `assemblers` gives the batch of a number, from 0 at the first step on, and runs on a thread of its
    /// own, ahead of the steps. `report` gives further metrics of the network after a number of steps. When it is asked to
    /// stop, it stores its present state.
    pub(crate) fn run<B: Send>(
        self,
        checkpoint_every: u32,
        assemblers: Vec<impl Fn(u64) -> Result<B, LearnError> + Send>,
        loss: &dyn Fn(&N, B) -> Loss,
        report: &dyn Fn(&N, u64) -> Result<Metrics, LearnError>,
        (peers, monitor): (&mut Peers, &mut dyn Monitor),
    ) -> Result<Option<Vec<u8>>, LearnError> {
        let per_step = u64::from(self.optim.gradient_accumulation);
        let numbers = self.info.step * per_step..self.optim.steps * per_step;
        ahead((numbers, waiting(assemblers.len())), assemblers, |next| {
            self.take_steps(checkpoint_every, next, loss, report, (peers, monitor))
        })
    }

    /// As [`Training::run`], with the batches of `next`.
    pub(crate) fn take_steps<B>(
        mut self,
        checkpoint_every: u32,
        next: Next<'_, B>,
        loss: &dyn Fn(&N, B) -> Loss,
        report: &dyn Fn(&N, u64) -> Result<Metrics, LearnError>,
        (peers, monitor): (&mut Peers, &mut dyn Monitor),
    ) -> Result<Option<Vec<u8>>, LearnError> {
        let (mut kept, steps, lead) = (self.info.step, self.optim.steps, peers.lead());
        // Of several ranks, one that is asked to stop takes all of them along in its next step.
        let mut stop = false;
        peers.align(self.info.step, self.optimizer.parameters())?;
        while self.info.step < steps {
            if stop || !peers.several() && monitor.cancelled() {
                let read = self.read((lead, monitor))?;
                self.send(if lead { &read } else { &[] }, monitor);
                if self.info.step > kept && lead {
                    // If storing fails here, a resumed run repeats these steps.
                    let _ = self.keep(monitor);
                }
                return Err(LearnError::Cancelled);
            }
            stop = self.step(next, loss, (peers, monitor))?;
            let done = self.info.step;
            let due = done.is_multiple_of(u64::from(checkpoint_every)) && done < steps;
            let read = self.unread.is_full() || due || done == steps;
            let mut read = if read { self.read((lead, monitor))? } else { Vec::new() };
            let further = if peers.several() && validation::due(done, steps) {
                // Measuring may take longer than ranks wait for each other.
                let parameters: Vec<Tensor> = self.optimizer.parameters().map(Tensor::shallow_clone).collect();
                peers.lead_alone(parameters.iter(), || self.report(report))?
            } else {
                lead.then(|| self.report(report))
            };
            if let Some(further) = further.transpose()? {
                match read.last_mut() {
                    Some((_, metrics)) => metrics.extend(further),
                    None => self.unread.extend(further),
                }
                self.send(&read, monitor);
            }
            if due {
                peers.lead_alone(self.optimizer.parameters(), || self.keep(monitor))?.transpose()?;
                kept = done;
                peers.align(done, self.optimizer.parameters())?;
            }
        }
        if !lead {
            return Ok(None);
        }
        self.info.finished = true;
        checkpoint::write(&self.info, &self.network.named()).map(Some)
    }

    /// Reads the steps that have not been read. If one diverged, the metrics of those before it are sent.
    fn read(&mut self, (lead, monitor): (bool, &mut dyn Monitor)) -> Result<Vec<(u64, Metrics)>, LearnError> {
        let (read, ended) = self.unread.read();
        if let (Err(_), true) = (&ended, lead) {
            self.send(&read, monitor);
        }
        ended.map(|()| read)
    }

    fn send(&self, read: &[(u64, Metrics)], monitor: &mut dyn Monitor) {
        read.iter().for_each(|(done, metrics)| monitor.progress(*done, self.optim.steps, metrics));
    }

    /// The further metrics after a step; those after the last one are of the weights that the model finishes with.
    fn report(&mut self, report: &dyn Fn(&N, u64) -> Result<Metrics, LearnError>) -> Result<Metrics, LearnError> {
        let done = self.info.step;
        let last = done == self.optim.steps;
        if last && !self.finished.is_best() {
            self.finished.finish();
        }
        let metrics = report(&self.network, done)?;
        let loss = metrics.iter().find(|(name, _)| *name == LOSS_VALIDATION);
        self.finished.after_report(loss.map(|(_, loss)| *loss));
        if last && self.finished.is_best() {
            self.finished.finish();
            return report(&self.network, done);
        }
        Ok(metrics)
    }

    /// One step of the optimiser, by the mean gradient of its batches. Returns whether a rank is asked to stop.
    fn step<B>(
        &mut self,
        next: Next<'_, B>,
        loss: &dyn Fn(&N, B) -> Loss,
        (peers, monitor): (&mut Peers, &dyn Monitor),
    ) -> Result<bool, LearnError> {
        let (begin, mut waited, mut assembling) = (Instant::now(), Duration::ZERO, Duration::ZERO);
        let step = self.info.step;
        let rate = self.optim.learning_rate_at(step);
        self.optimizer.zero_grad();
        // Losses on held-out episodes, between the steps, are in f32.
        let _tf32 = Tf32::of(self.optim.precision)?;
        let batches = f64::from(self.optim.gradient_accumulation);
        let mut sums = Sums::default();
        for _ in 0..self.optim.gradient_accumulation {
            let due = Instant::now();
            let Assembled { batch, took } = next()?;
            waited += due.elapsed();
            assembling += took;
            let loss = precision::with(self.optim.precision, || loss(&self.network, batch));
            let total = loss.total / batches;
            total.backward();
            sums.add("loss", &total, 1.0);
            loss.parts.iter().for_each(|(name, part)| sums.add(name, part, batches));
        }
        let mut gradients = self.optimizer.gradients();
        let due = Instant::now();
        let stop = peers.sum(&mut gradients, self.optimizer.parameters(), &mut sums.numbers(), monitor.cancelled())?;
        let summing = peers.several().then(|| due.elapsed());
        let gathered = self.optimizer.gather(&gradients);
        let norm = self.optimizer.gradient_norm(&gathered, &self.optim);
        if let Some(norm) = &norm {
            self.optimizer.apply(&gathered, step, rate, norm, &self.optim);
        }
        self.info.step += 1;
        self.finished.after_step(self.info.step);
        let (spent, assembling) = (begin.elapsed(), assembling / self.optim.gradient_accumulation);
        let further = Metrics::new();
        self.unread.push(Step { number: step, sums, norm, rate, spent, waited, summing, assembling, further });
        Ok(stop)
    }

    fn keep(&self, monitor: &mut dyn Monitor) -> Result<(), LearnError> {
        let (bytes, step) = (checkpoint::write(&self.info, &self.state())?, self.info.step);
        monitor.checkpoint(step, &bytes).map_err(|message| LearnError::Monitor { step, message })
    }

    /// All values that a resumed run needs.
    fn state(&self) -> Vec<(String, Tensor)> {
        let mut named = self.network.named();
        named.extend(self.optimizer.named());
        named.extend(self.finished.named());
        named
    }
}

#[cfg(test)]
mod tests;
