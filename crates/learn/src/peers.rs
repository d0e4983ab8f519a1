//! The other processes of a training, which work on the other parts of each batch: the sums of gradients and numbers
//! between `backward()` and the optimiser's step. Those of a score run or an evaluation exchange results exactly ([`exchange`]).
//! Independent of models, losses and scores.
//!
//! In a training, every rank draws the same batches and computes its share of the loss, so that the sum over the ranks is the loss of
//! one process, up to rounding. All ranks apply the same bits, so their weights stay equal.

mod exchange;
mod signs;
#[cfg(test)]
pub(crate) mod testing;

use gleaner_group::Group;
use tch::{Device, Kind, Tensor, no_grad_guard};

use crate::batch::{Part, int, values};
use crate::error::LearnError;
use crate::optimizer::Gradients;

pub(crate) use exchange::Receivers;

/// The processes of a training, a score run or an evaluation.
#[derive(Debug, Default)]
pub struct Peers(Option<Group>);

impl Peers {
    /// One process.
    #[must_use]
    pub fn alone() -> Self {
        Self(None)
    }

    /// The ranks of a group.
    #[must_use]
    pub fn of(group: Group) -> Self {
        Self(Some(group))
    }

    /// Whether this process reports, stores checkpoints and has the result: rank 0 does.
    #[must_use]
    pub fn lead(&self) -> bool {
        self.0.as_ref().is_none_or(|group| group.rank() == 0)
    }

    /// Whether there are others.
    pub(crate) fn several(&self) -> bool {
        self.0.is_some()
    }

    /// The part of each batch that this process works on.
    pub(crate) fn part(&self) -> Part {
        self.0.as_ref().map_or(Part::WHOLE, |group| Part::of(group.rank(), group.ranks()))
    }

    /// Fails for batches of fewer segments than there are ranks.
    pub(crate) fn can_share(&self, batch: u32) -> Result<(), LearnError> {
        match &self.0 {
            Some(group) if group.ranks() > batch => Err(LearnError::invalid(
                "batch",
                format!(
                    "is {batch}, fewer segments than the {} ranks that share it; raise it, or train with fewer ranks",
                    group.ranks()
                ),
            )),
            Some(_) | None => Ok(()),
        }
    }

    /// Gives every rank the parameters of rank 0. Processors that round alike have them already.
    ///
    /// # Errors
    /// When a rank is at another step, or is lost.
    pub(crate) fn align<'a>(
        &mut self,
        step: u64,
        parameters: impl Iterator<Item = &'a Tensor> + Clone,
    ) -> Result<(), LearnError> {
        let Some(group) = &mut self.0 else { return Ok(()) };
        let _no_grad = no_grad_guard();
        let [high, low] = [step >> 24, step & 0xFF_FFFF].map(|half| u32::try_from(half).unwrap_or(u32::MAX));
        let own = [f64::from(high), f64::from(low)];
        let own = Tensor::from_slice(&own).to_kind(Kind::Float);
        let device = device_of(parameters.clone());
        let weights = parameters.clone().map(|parameter| parameter.detach().flatten(0, -1));
        let flat: Vec<Tensor> = std::iter::once(own.to_device(device)).chain(weights).collect();
        let mut flat = Tensor::cat(&flat, 0);
        group.broadcast(&mut flat)?;
        if values(&flat.narrow(0, 0, 2)) != values(&own) {
            return Err(LearnError::invalid(
                "checkpoint",
                "differs between the ranks of this training; start it again",
            ));
        }
        let mut at = 2;
        for parameter in parameters {
            let count = int(parameter.numel());
            parameter.detach().copy_(&flat.narrow(0, at, count).view_as(parameter));
            at += count;
        }
        Ok(())
    }

    /// Makes `gradients`, of these parameters, and the scalars `numbers` the sums of the ranks'. `stop`: this rank
    /// is asked to stop. Returns whether any is.
    ///
    /// # Errors
    /// When a rank is lost.
    pub(crate) fn sum<'a>(
        &mut self,
        gradients: &mut Gradients,
        parameters: impl Iterator<Item = &'a Tensor> + Clone,
        numbers: &mut [&mut Tensor],
        stop: bool,
    ) -> Result<bool, LearnError> {
        let Some(group) = &mut self.0 else { return Ok(false) };
        let _no_grad = no_grad_guard();
        let device = device_of(parameters.clone());
        // One buffer: the gradients, how many ranks have each of them, the numbers, and the requests to stop.
        let mut flat: Vec<Tensor> = Vec::with_capacity(gradients.len() + numbers.len() + 2);
        for (gradient, parameter) in gradients.iter().zip(parameters.clone()) {
            let gradient = gradient.as_ref().map_or_else(|| parameter.zeros_like(), Tensor::shallow_clone);
            flat.push(gradient.to_kind(Kind::Float).flatten(0, -1));
        }
        let mut notes: Vec<f32> = gradients.iter().map(|gradient| f32::from(u8::from(gradient.is_some()))).collect();
        notes.push(f32::from(u8::from(stop)));
        flat.push(Tensor::from_slice(&notes).to_device(device));
        flat.extend(numbers.iter().map(|number| number.to_kind(Kind::Float).to_device(device).view([1])));
        let mut flat = Tensor::cat(&flat, 0);
        group.sum(&mut flat)?;

        let mut at = 0;
        let mut next = |count: usize| {
            at += int(count);
            flat.narrow(0, at - int(count), int(count))
        };
        let summed: Vec<Tensor> =
            parameters.map(|parameter| next(parameter.numel()).view(parameter.size().as_slice())).collect();
        let notes = values(&next(notes.len()));
        for ((gradient, sum), ranks) in gradients.iter_mut().zip(summed).zip(&notes) {
            *gradient = (*ranks > 0.0).then_some(sum);
        }
        for number in numbers {
            // A view would keep the buffer of all gradients.
            **number = next(1).squeeze().copy();
        }
        Ok(notes.last().is_some_and(|asked| *asked > 0.0))
    }
}

/// Where these parameters are.
fn device_of<'a>(mut parameters: impl Iterator<Item = &'a Tensor>) -> Device {
    parameters.next().map_or(Device::Cpu, Tensor::device)
}

#[cfg(test)]
mod tests;
