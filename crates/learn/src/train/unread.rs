//! Steps whose numbers are still on the device. Reading a number waits for the device, so those of several steps are read
//! at once, while the device goes from one step to the next without a pause.

use std::time::{Duration, Instant};

use tch::{Device, Kind, Tensor, no_grad_guard};

use super::sums::{Metrics, Sums};
use crate::error::LearnError;

/// Steps that are read at once from a device that works while its caller continues.
const AT_ONCE: usize = 16;

/// A step that was taken.
pub(super) struct Step {
    /// Its number, from 0.
    pub(super) number: u64,
    pub(super) sums: Sums,
    /// The gradient norm; `None` without a gradient.
    pub(super) norm: Option<Tensor>,
    pub(super) rate: f64,
    /// Of the caller: for the whole step, and of that for batches and for other ranks, if there are any.
    pub(super) spent: Duration,
    pub(super) waited: Duration,
    pub(super) summing: Option<Duration>,
    /// Of the batches' own thread, for each batch.
    pub(super) assembling: Duration,
    /// Further metrics after the step.
    pub(super) further: Metrics,
}

/// The steps that have not been read.
pub(super) struct Unread {
    steps: Vec<Step>,
    at_once: usize,
}

impl Unread {
    /// Of steps on this device.
    pub(super) fn on(device: Device) -> Self {
        Self { steps: Vec::new(), at_once: if device.is_cuda() { AT_ONCE } else { 1 } }
    }

    /// The same with another number of steps that are read at once.
    #[cfg(test)]
    pub(super) fn at_once(at_once: usize) -> Self {
        Self { steps: Vec::new(), at_once }
    }

    pub(super) fn push(&mut self, step: Step) {
        self.steps.push(step);
    }

    /// Adds metrics to the newest step.
    pub(super) fn extend(&mut self, further: Metrics) {
        if let Some(step) = self.steps.last_mut() {
            step.further.extend(further);
        }
    }

    /// Whether there are as many steps as are read at once.
    pub(super) fn is_full(&self) -> bool {
        self.steps.len() >= self.at_once
    }

    /// The number of steps after each of these, with its metrics: up to the first whose loss or gradient is not finite,
    /// which is the error.
    pub(super) fn read(&mut self) -> (Vec<(u64, Metrics)>, Result<(), LearnError>) {
        let (steps, begin) = (std::mem::take(&mut self.steps), Instant::now());
        let mut read = numbers(&steps).into_iter();
        let of_reading =
            begin.elapsed().as_secs_f64() / f64::from(u32::try_from(steps.len().max(1)).unwrap_or(u32::MAX));
        let mut all = Vec::with_capacity(steps.len());
        for step in steps {
            let norm = step.norm.map_or(0.0, |_| read.next().unwrap_or(f64::NAN));
            let mut metrics = step.sums.named(&mut read);
            if !(norm.is_finite() && metrics.first().is_some_and(|(_, loss)| loss.is_finite())) {
                return (all, Err(LearnError::Diverged { step: step.number }));
            }
            let took = (step.spent.as_secs_f64() + of_reading).max(f64::MIN_POSITIVE);
            metrics.extend([
                ("grad_norm", norm),
                ("learning_rate", step.rate),
                ("ms_per_step", took * 1e3),
                ("ms_per_batch", step.assembling.as_secs_f64() * 1e3),
                ("waited_share", step.waited.as_secs_f64() / took),
            ]);
            metrics.extend(step.summing.map(|summing| ("summing_share", summing.as_secs_f64() / took)));
            metrics.extend(step.further);
            all.push((step.number + 1, metrics));
        }
        (all, Ok(()))
    }
}

/// The norm, if there is one, and the sums of each step, by one copy from the device.
fn numbers(steps: &[Step]) -> Vec<f64> {
    let _no_grad = no_grad_guard();
    let scalars = steps.iter().flat_map(|step| step.norm.iter().chain(step.sums.scalars()));
    let scalars: Vec<Tensor> = scalars.map(|scalar| scalar.to_kind(Kind::Double)).collect();
    let mut read = vec![0f64; scalars.len()];
    if !read.is_empty() {
        Tensor::stack(&scalars, 0).to_device(Device::Cpu).copy_data(&mut read, scalars.len());
    }
    read
}
