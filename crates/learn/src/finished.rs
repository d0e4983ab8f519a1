//! The weights of a finished model: those of the last step, their moving average, the mean of five late steps, or the best
//! by validation.
//! Independent of the loss.

use std::collections::BTreeMap;

use gleaner_core::{FinishedWeights, OptimSpec};
use tch::{Kind, Tensor, no_grad_guard};

use crate::error::LearnError;
use crate::model::weights;

/// Prefix of the kept weights in a checkpoint of an unfinished run.
const KEPT: &str = "finished.";
/// The name of the lowest validation loss there.
const LOSS: &str = "finished_loss";

/// Steps whose weights `mean` averages.
const LATE: u64 = 5;
/// Their distance as a part of all steps.
const APART: u64 = 20;

/// The weights that a run would finish with.
pub(crate) struct Finished {
    rule: FinishedWeights,
    decay: f64,
    /// Steps of the run.
    steps: u64,
    parameters: Vec<(String, Tensor)>,
    /// The average so far, or the best so far; empty before there are any.
    kept: Vec<(String, Tensor)>,
    /// The lowest validation loss.
    loss: f64,
}

impl Finished {
    /// Of a run from the first step, whose parameters these are.
    pub(crate) fn new(optim: &OptimSpec, parameters: Vec<(String, Tensor)>) -> Self {
        let OptimSpec { finished_weights: rule, ema_decay: decay, steps, .. } = *optim;
        Self { rule, decay, steps, parameters, kept: Vec::new(), loss: f64::INFINITY }
    }

    /// Takes the state from `named`.
    pub(crate) fn load(&mut self, named: &BTreeMap<String, Tensor>) -> Result<(), LearnError> {
        let Some(loss) = named.get(LOSS) else { return Ok(()) };
        self.loss = loss.double_value(&[0]);
        self.kept = self.copies();
        let kept = self.kept.iter().map(|(name, kept)| (format!("{KEPT}{name}"), kept.shallow_clone()));
        weights::load(&kept.collect::<Vec<_>>(), named)
    }

    /// The state with its names in a checkpoint.
    pub(crate) fn named(&self) -> Vec<(String, Tensor)> {
        if self.kept.is_empty() {
            return Vec::new();
        }
        let kept = self.kept.iter().map(|(name, kept)| (format!("{KEPT}{name}"), kept.shallow_clone()));
        let loss = Tensor::from_slice(&[self.loss]).to_kind(Kind::Float);
        kept.chain([(LOSS.to_owned(), loss)]).collect()
    }

    /// Adds the weights after `done` steps to the average.
    pub(crate) fn after_step(&mut self, done: u64) {
        let Some(share) = self.share(done) else { return };
        if self.kept.is_empty() {
            self.kept = self.copies();
        }
        let _no_grad = no_grad_guard();
        for ((_, kept), (_, parameter)) in self.kept.iter_mut().zip(&self.parameters) {
            let _ = kept.lerp_(parameter, share);
        }
    }

    /// The share of the weights after `done` steps in the average up to them; `None` if they are no part of it.
    fn share(&self, done: u64) -> Option<f64> {
        match self.rule {
            FinishedWeights::Last | FinishedWeights::Best => None,
            FinishedWeights::Ema => {
                #[expect(clippy::cast_precision_loss, reason = "step counts are far below 2^52")]
                let decay = (1.0 - (1.0 + done as f64).powf(-0.75)).min(self.decay);
                Some(1.0 - decay)
            }
            FinishedWeights::Mean => {
                let apart = self.steps.div_ceil(APART);
                let left = self.steps.checked_sub(done)?;
                let first = ((self.steps - 1) / apart).min(LATE - 1);
                let after = left / apart;
                #[expect(clippy::cast_precision_loss, reason = "at most five")]
                (left.is_multiple_of(apart) && after <= first).then(|| 1.0 / (first - after + 1) as f64)
            }
        }
    }

    /// Keeps the present weights if their validation loss, if it was measured, is the lowest so far.
    pub(crate) fn after_report(&mut self, loss_validation: Option<f64>) {
        // Rounded as a checkpoint stores it, so that a resumed run decides alike.
        #[expect(clippy::cast_possible_truncation, reason = "a loss")]
        let loss = loss_validation.map(|loss| f64::from(loss as f32));
        if let Some(loss) = loss.filter(|loss| self.rule == FinishedWeights::Best && *loss < self.loss) {
            self.loss = loss;
            self.kept = self.copies();
        }
    }

    /// Whether the best weights are known only after the last report.
    pub(crate) fn is_best(&self) -> bool {
        self.rule == FinishedWeights::Best
    }

    /// Copies the kept weights into the model.
    pub(crate) fn finish(&self) {
        let _no_grad = no_grad_guard();
        for ((_, kept), (_, parameter)) in self.kept.iter().zip(&self.parameters) {
            parameter.shallow_clone().copy_(kept);
        }
    }

    fn copies(&self) -> Vec<(String, Tensor)> {
        self.parameters.iter().map(|(name, parameter)| (name.clone(), parameter.detach().copy())).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::batch::values;

    fn parameter(value: f32) -> Vec<(String, Tensor)> {
        vec![("x".to_owned(), Tensor::from_slice(&[value]))]
    }

    /// The same tensors.
    fn shared(parameters: &[(String, Tensor)]) -> Vec<(String, Tensor)> {
        parameters.iter().map(|(name, x)| (name.clone(), x.shallow_clone())).collect()
    }

    fn set(parameters: &[(String, Tensor)], value: f64) {
        let _ = parameters[0].1.shallow_clone().fill_(value);
    }

    fn rule(finished_weights: FinishedWeights) -> OptimSpec {
        OptimSpec { finished_weights, ema_decay: 0.6, ..OptimSpec::default() }
    }

    #[test]
    fn the_average_follows_its_formula_and_survives_a_resume() {
        let parameters = parameter(0.0);
        let mut finished = Finished::new(&rule(FinishedWeights::Ema), shared(&parameters));
        set(&parameters, 1.0);
        finished.after_step(1);
        // The first average is the first weight; the decay is 1 − 3^−0.75 = 0.561 at step 2, then the limit 0.6.
        set(&parameters, 2.0);
        finished.after_step(2);
        let mut resumed = Finished::new(&rule(FinishedWeights::Ema), shared(&parameters));
        resumed.load(&finished.named().into_iter().collect()).unwrap();
        set(&parameters, 4.0);
        resumed.after_step(3);
        resumed.finish();
        let second = 1.0 + 3f32.powf(-0.75);
        let third = second + 0.4 * (4.0 - second);
        assert!((values(&parameters[0].1)[0] - third).abs() < 1e-6, "{:?}", values(&parameters[0].1));
    }

    #[test]
    fn the_mean_is_of_five_late_steps_and_survives_a_resume() {
        for (steps, at) in [(100, vec![80, 85, 90, 95, 100]), (50, vec![38, 41, 44, 47, 50]), (3, vec![1, 2, 3])] {
            let optim = OptimSpec { steps, ..rule(FinishedWeights::Mean) };
            let parameters = parameter(0.0);
            let mut finished = Finished::new(&optim, shared(&parameters));
            for done in 1..=steps {
                set(&parameters, f64::from(u32::try_from(done).unwrap()));
                finished.after_step(done);
                let mut resumed = Finished::new(&optim, shared(&parameters));
                resumed.load(&finished.named().into_iter().collect()).unwrap();
                finished = resumed;
            }
            finished.finish();
            let mean = at.iter().sum::<u16>() as f32 / at.len() as f32;
            assert!((values(&parameters[0].1)[0] - mean).abs() < 1e-4, "{steps}: {:?}", values(&parameters[0].1));
        }
    }

    #[test]
    fn the_best_weights_are_those_of_the_lowest_validation_loss() {
        let parameters = parameter(0.0);
        let mut finished = Finished::new(&rule(FinishedWeights::Best), shared(&parameters));
        for (value, loss) in [(1.0, 0.5), (2.0, 0.2), (3.0, 0.3)] {
            set(&parameters, value);
            finished.after_report(Some(loss));
        }
        let mut resumed = Finished::new(&rule(FinishedWeights::Best), shared(&parameters));
        resumed.load(&finished.named().into_iter().collect()).unwrap();
        resumed.after_report(None);
        resumed.after_report(Some(0.25));
        resumed.finish();
        assert_eq!(values(&parameters[0].1), [2.0]);
    }

    #[test]
    fn last_keeps_no_copy_of_the_weights() {
        let parameters = parameter(1.0);
        let mut finished = Finished::new(&rule(FinishedWeights::Last), shared(&parameters));
        finished.after_step(1);
        finished.after_report(Some(0.1));
        set(&parameters, 5.0);
        finished.finish();
        assert!(finished.named().is_empty());
        assert_eq!(values(&parameters[0].1), [5.0]);
    }
}
