//! The policy `diffusion`: Diffusion Policy (Chi et al. 2023) with a transformer.
//!
//! With x_0 the chunk scaled to −1 … 1 by the range of each action value, noise ε ~ N(0, 1) and t one of T steps,
//! x_t = √ᾱ_t x_0 + √(1 − ᾱ_t) ε; the network predicts ε from x_t, t, o_t and m_t, and the loss is the mean squared error.
//! Acting removes the noise by DDIM over some of the steps, the last one first: x̂_0 = (x_t − √(1 − ᾱ_t) ε) / √ᾱ_t, clipped
//! to −1 … 1, and then the same mix at the next step.
//!
//! Unlike in the original, a place of the chunk attends to later places too. A causal network cannot predict the gradient
//! of the chunk's density, so its samples mix ways to act (docs/results/policies.md).

use std::collections::BTreeMap;

use gleaner_core::kinds::Needs;
use gleaner_core::schema::integer_in;
use gleaner_core::{Group as _, OptimSpec, Setting};
use tch::{Device, Tensor};

use super::denoise::{self, Mixed, Process};
use super::kind::{NewPolicy, PolicyInit, PolicyKind};
use super::observer;
use crate::batch::int;
use crate::checkpoint::CheckpointInfo;
use crate::error::LearnError;
use crate::normalize::{Ranges, Sample, Statistics};
use crate::shape::TaskShape;

pub(super) const KIND: PolicyKind = PolicyKind {
    name: "diffusion",
    title: "Diffusion Policy",
    about: "Diffusion Policy: chunks of actions are drawn by removing noise in many small steps.",
    needs: Needs { encoder: false, history: false, images: true, all_episodes: false },
    settings,
    optim: OptimSpec::default,
    model: observer::model,
    init,
    load,
};

gleaner_core::settings! {
    /// Settings of the noise.
    #[derive(Copy)]
    struct NoiseSpec {
        /// Steps between a chunk and pure noise in training (T). At most this many are used as sampling_steps.
        diffusion_steps: u32 = 100, integer_in(2, 1000);
    }
}

/// The name of the ranges in a checkpoint.
const RANGE: &str = "statistics.action.range";

fn settings() -> Vec<Setting> {
    [denoise::schema(), NoiseSpec::schema()].concat()
}

fn init(from: &PolicyInit<'_>, info: &CheckpointInfo) -> NewPolicy {
    let range = range(from.shape, from.sample)?.to(from.device);
    denoise::init(Diffusion::new(info, range)?, from, info)
}

fn load(info: &CheckpointInfo, named: &BTreeMap<String, Tensor>, device: Device) -> NewPolicy {
    let range = named.get(RANGE).filter(|range| range.size() == [2, int(info.shape.action)]);
    let range =
        range.ok_or_else(|| LearnError::Checkpoint(format!("`{RANGE}` is missing or is not two rows of actions")))?;
    denoise::load(Diffusion::new(info, range.to(device))?, info, named, device)
}

/// Per action value the middle and half the width of its range in the sample, `[2, A]`; a constant value has the half
/// width 1.
fn range(shape: &TaskShape, sample: &Sample<'_>) -> Result<Tensor, LearnError> {
    let ranges = Ranges::of_actions(shape, sample)?;
    let (middle, half): (Vec<f32>, Vec<f32>) =
        ranges.middles().map(|(middle, half)| (middle, half.unwrap_or(1.0))).unzip();
    Ok(Tensor::from_slice2(&[middle, half]))
}

struct Diffusion {
    schedule: Schedule,
    /// `[2, A]`, see [`range`].
    range: Tensor,
}

impl Diffusion {
    fn new(info: &CheckpointInfo, range: Tensor) -> Result<Self, LearnError> {
        let NoiseSpec { diffusion_steps } = info.settings()?;
        Ok(Self { schedule: Schedule::new(diffusion_steps), range })
    }
}

impl Process for Diffusion {
    fn scaled(&self, _: &Statistics, action: &Tensor) -> Tensor {
        (action - self.range.get(0)) / self.range.get(1)
    }

    fn standardised(&self, statistics: &Statistics, chunk: Tensor) -> Tensor {
        statistics.action.apply(&(chunk * self.range.get(1) + self.range.get(0)))
    }

    fn time(&self, uniform: f64) -> f64 {
        self.schedule.time(uniform)
    }

    fn mix(&self, chunk: &Tensor, noise: &Tensor, time: &Tensor) -> Mixed {
        self.schedule.mix(chunk, noise, time)
    }

    /// The noise ε = (x − √ᾱ a) / √(1 − ᾱ).
    fn removal(&self, noisy: &Tensor, chunk: &Tensor, time: f64) -> Tensor {
        let left = self.schedule.left_at((time * self.schedule.count()).round());
        (noisy - chunk * left.sqrt()) / (1.0 - left).sqrt()
    }

    fn draw(&self, noise: &Tensor, passes: u32, predict: &dyn Fn(&Tensor, f64) -> Tensor) -> Tensor {
        self.schedule.sample(noise, passes, true, predict)
    }

    fn constants(&self) -> Vec<(String, Tensor)> {
        vec![(RANGE.to_owned(), self.range.shallow_clone())]
    }
}

/// How much of the chunk is left at each step: ᾱ by the squared cosine.
struct Schedule {
    left: Vec<f64>,
}

impl Schedule {
    fn new(steps: u32) -> Self {
        let cosine = |part: f64| ((part + 0.008) / 1.008 * std::f64::consts::FRAC_PI_2).cos().powi(2);
        let all = f64::from(steps);
        let beta = |i: f64| (1.0 - cosine((i + 1.0) / all) / cosine(i / all)).min(0.999);
        let left = (0..steps).scan(1.0, |left, i| {
            *left *= 1.0 - beta(f64::from(i));
            Some(*left)
        });
        Self { left: left.collect() }
    }

    #[expect(clippy::cast_precision_loss, reason = "at most 1000 steps")]
    fn count(&self) -> f64 {
        self.left.len() as f64
    }

    /// The time of a step, in 0 … 1: each step is equally likely.
    fn time(&self, uniform: f64) -> f64 {
        (uniform * self.count()).floor() / self.count()
    }

    /// √ᾱ and √(1 − ᾱ) of times `[R, 1, 1]`.
    fn parts(&self, time: &Tensor) -> [Tensor; 2] {
        let step = (time * self.count()).round().to_kind(tch::Kind::Int64);
        let left = Tensor::from_slice(&self.left).to(time.device()).to_kind(time.kind());
        let left = left.index_select(0, &step.view([-1])).view_as(time);
        [left.sqrt(), (&left * -1.0 + 1.0).sqrt()]
    }

    fn mix(&self, chunk: &Tensor, noise: &Tensor, time: &Tensor) -> Mixed {
        let [kept, added] = self.parts(time);
        Mixed { noisy: chunk * kept + noise * added, target: noise.shallow_clone() }
    }

    /// Removes noise by DDIM in `passes` steps, evenly spaced from the last on, each predicted by `noise_of(x, time)`.
    fn sample(&self, noise: &Tensor, passes: u32, clips: bool, noise_of: impl Fn(&Tensor, f64) -> Tensor) -> Tensor {
        let passes = f64::from(passes).min(self.count());
        let mut x = noise.shallow_clone();
        let mut pass = 0.0;
        while pass < passes {
            let step = |pass: f64| (self.count() - pass * self.count() / passes).round() - 1.0;
            let [left, next] = [step(pass), step(pass + 1.0)].map(|step| self.left_at(step));
            let found = noise_of(&x, step(pass) / self.count());
            let mut chunk = (&x - &found * (1.0 - left).sqrt()) / left.sqrt();
            if clips {
                chunk = chunk.clamp(-1.0, 1.0);
            }
            x = chunk * next.sqrt() + found * (1.0 - next).sqrt();
            pass += 1.0;
        }
        x
    }

    /// ᾱ at a step; 1 before the first.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a step's number, or −1")]
    fn left_at(&self, step: f64) -> f64 {
        if step < 0.0 { 1.0 } else { self.left.get(step as usize).copied().unwrap_or(0.0) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, generator, normal};

    #[test]
    fn the_schedule_is_the_squared_cosine() {
        let schedule = Schedule::new(100);
        for (step, expected) in [(0.0, 0.99937), (50.0, 0.47826)] {
            assert!((schedule.left_at(step) - expected).abs() < 1e-5, "{}", schedule.left_at(step));
        }
        assert!((schedule.left_at(99.0) / 2.4e-7 - 1.0).abs() < 0.05 && schedule.left_at(-1.0) == 1.0);
        let time = Tensor::from_slice(&[schedule.time(0.509), schedule.time(0.999)]).view([2, 1, 1]);
        let [kept, _] = schedule.parts(&time);
        assert!((kept.square().double_value(&[0, 0, 0]) - 0.47826).abs() < 1e-5);
    }

    /// The mean and deviation of chunks drawn by the exact predictor for N(0.3, 0.5²), against numbers computed apart.
    #[test]
    fn sampling_by_an_exact_predictor_has_the_known_moments() {
        let schedule = Schedule::new(100);
        let (mean, deviation) = (0.3, 0.5f64);
        let noise = normal(&mut generator(1, Purpose::Style, 0), 100_000);
        let noise = Tensor::from_slice(&noise).to_kind(tch::Kind::Double);
        let noise = (&noise - noise.mean(None)) / noise.std(true);
        let exact = |x: &Tensor, time: f64| {
            let left = schedule.left_at((time * 100.0).round());
            let variance = left * deviation.powi(2) + 1.0 - left;
            (x - mean * left.sqrt()) * ((1.0 - left).sqrt() / variance)
        };
        for (passes, expected) in [(10, 0.4268), (100, 0.4921)] {
            let drawn = schedule.sample(&noise, passes, false, exact);
            let found = [drawn.mean(None).double_value(&[]), drawn.std(true).double_value(&[])];
            assert!((found[0] - mean).abs() < 1e-3 && (found[1] - expected).abs() < 1e-3, "{passes}: {found:?}");
        }
        let clipped = schedule.sample(&noise, 10, true, |x, _| x.zeros_like());
        assert!(clipped.abs().max().double_value(&[]) <= 1.0);
    }

    #[test]
    fn actions_are_scaled_by_their_range_and_constant_ones_are_centred() {
        let shape = crate::toy::shape();
        let data = crate::toy::episode("e", 1, 3, true).with_actions(vec![1.0, 7.0, 5.0, 7.0, 2.0, 7.0]);
        let found = range(&shape, &Sample::every(&[&data])).unwrap();
        assert_eq!(crate::batch::values(&found), [3.0, 7.0, 2.0, 1.0]);
    }
}
