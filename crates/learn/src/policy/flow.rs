//! The policy `flow`: flow matching over chunks (the action head of π0 and SmolVLA, at our size).
//!
//! With noise ε ~ N(0, 1) and time t = 0.001 + 0.999 u^{2/3} (u uniform; t = 1 is noise), x_t = t ε + (1 − t) a, and the
//! network predicts the velocity ε − a from x_t, t, o_t and m_t: the loss is the mean squared error. Acting integrates
//! from noise at t = 1 to a chunk at t = 0 by Euler's method. With `prediction chunk` the network predicts a instead, which
//! gives the same field.

use std::collections::BTreeMap;

use gleaner_core::OptimSpec;
use gleaner_core::kinds::Needs;
use tch::{Device, Tensor};

use super::denoise::{self, Mixed, Process};
use super::kind::{NewPolicy, PolicyInit, PolicyKind};
use super::observer;
use crate::checkpoint::CheckpointInfo;
use crate::normalize::Statistics;

pub(super) const KIND: PolicyKind = PolicyKind {
    name: "flow",
    title: "Flow matching",
    about: "Flow matching: chunks of actions are drawn from noise, which represents several ways to act.",
    needs: Needs { encoder: false, history: false, images: true, all_episodes: false },
    settings: denoise::schema,
    optim: OptimSpec::default,
    model: observer::model,
    init,
    load,
};

fn init(from: &PolicyInit<'_>, info: &CheckpointInfo) -> NewPolicy {
    denoise::init(Flow, from, info)
}

fn load(info: &CheckpointInfo, named: &BTreeMap<String, Tensor>, device: Device) -> NewPolicy {
    denoise::load(Flow, info, named, device)
}

struct Flow;

impl Process for Flow {
    fn scaled(&self, statistics: &Statistics, action: &Tensor) -> Tensor {
        statistics.action.apply(action)
    }

    fn standardised(&self, _: &Statistics, chunk: Tensor) -> Tensor {
        chunk
    }

    /// Noisy times are more likely.
    fn time(&self, uniform: f64) -> f64 {
        0.001 + 0.999 * uniform.powf(2.0 / 3.0)
    }

    fn mix(&self, chunk: &Tensor, noise: &Tensor, time: &Tensor) -> Mixed {
        Mixed { noisy: noise * time + chunk * (1.0 - time), target: noise - chunk }
    }

    /// The velocity ε − a = (x_t − a) / t.
    fn removal(&self, noisy: &Tensor, chunk: &Tensor, time: f64) -> Tensor {
        (noisy - chunk) / time
    }

    fn draw(&self, noise: &Tensor, passes: u32, predict: &dyn Fn(&Tensor, f64) -> Tensor) -> Tensor {
        integrate(noise, passes, predict)
    }
}

/// Follows the field `velocity(x, t)` from noise at t = 1 to t = 0 in equal steps.
fn integrate(noise: &Tensor, steps: u32, velocity: impl Fn(&Tensor, f64) -> Tensor) -> Tensor {
    let step = 1.0 / f64::from(steps);
    (0..steps).fold(noise.shallow_clone(), |x, i| &x - velocity(&x, 1.0 - f64::from(i) * step) * step)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::batch::values;
    use crate::random::{Purpose, generator, normal};

    /// The mean and deviation of chunks drawn by the exact field of N(0.3, 0.5²), against numbers computed apart.
    #[test]
    fn integration_of_an_exact_field_has_the_known_moments() {
        let (mean, deviation) = (0.3, 0.5f64);
        let velocity = |x: &Tensor, t: f64| {
            let s2 = deviation.powi(2);
            let slope = (t - (1.0 - t) * s2) / (t.powi(2) + (1.0 - t).powi(2) * s2);
            (x - (1.0 - t) * mean) * slope - mean
        };
        let noise = normal(&mut generator(1, Purpose::Style, 0), 100_000);
        // Exactly N(0, 1) in its first two moments.
        let noise = Tensor::from_slice(&noise).to_kind(tch::Kind::Double);
        let noise = (&noise - noise.mean(None)) / noise.std(true);
        for (steps, expected) in [(5, 0.369), (10, 0.431), (20, 0.464), (100, 0.493)] {
            let drawn = integrate(&noise, steps, velocity);
            let found = [drawn.mean(None).double_value(&[]), drawn.std(true).double_value(&[])];
            assert!((found[0] - mean).abs() < 1e-6 && (found[1] - expected).abs() < 1e-3, "{steps}: {found:?}");
        }
    }

    #[test]
    fn times_of_training_are_noisy_and_the_mix_ends_at_noise_and_at_the_chunk() {
        let mean = (0..1000).map(|i| Flow.time((f64::from(i) + 0.5) / 1000.0)).sum::<f64>() / 1000.0;
        assert!((mean - (0.001 + 0.999 * 0.6)).abs() < 1e-4, "{mean}");
        let (chunk, noise) = (Tensor::from_slice(&[2f32]), Tensor::from_slice(&[-1f32]));
        let at = |t: f32| {
            let Mixed { noisy, target } = Flow.mix(&chunk, &noise, &Tensor::from_slice(&[t]));
            let removal = Flow.removal(&noisy, &chunk, t.into());
            assert!(t == 0.0 || values(&(removal - &target))[0].abs() < 1e-6, "{t}");
            [values(&noisy)[0], values(&target)[0]]
        };
        assert_eq!((at(0.0), at(1.0), at(0.25)), ([2.0, -3.0], [-1.0, -3.0], [1.25, -3.0]));
    }
}
