//! Policies that draw a chunk by removing noise from it step by step: their common settings, network and loss. A
//! drawn chunk is a sample of P(a_t … a_{t+k−1} | o_t, m_t), so several right ways to act are not averaged into a wrong one.
//! Independent of the schedule of the noise.
//!
//! A place of a chunk that does not count, as in ACT, costs nothing and is hidden from the other places.

mod network;

use std::collections::BTreeMap;

use gleaner_core::schema::integer_in;
use gleaner_core::{Group as _, Setting, Words as _};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use tch::{Device, Tensor};

use super::chunk::ChunkSpec;
use super::hiding::HistorySpec;
use super::kind::{Losses, NewPolicy, PolicyInfo, PolicyInit, PolicyInput, PolicyModel};
use super::observer::{self, Encoded, Observer};
use crate::batch::Chunks;
use crate::checkpoint::CheckpointInfo;
use crate::error::LearnError;
use crate::normalize::Statistics;
use crate::random::normal;
use network::Network;

gleaner_core::words! {
    /// What the network predicts of a noisy chunk.
    enum Prediction {
        /// What to remove from it, as in the papers. The network has to reproduce the noise exactly, which takes long
        /// trainings.
        Noise = "noise",
        /// The chunk without noise. Already the first guess, of pure noise, is that of behaviour cloning.
        Chunk = "chunk",
    }
}

gleaner_core::settings! {
    /// Settings of a policy that draws its chunks from noise.
    #[derive(Copy)]
    struct DrawSpec {
        /// Number of passes of the network that remove the noise from a chunk. More passes draw more exactly and take
        /// longer.
        sampling_steps: u32 = 10, integer_in(1, 1000);
        /// Pairs of noise and time for each segment of a batch. More pairs give a smoother loss at little cost, because
        /// they share the segment's image.
        noise_pairs: u32 = 4, integer_in(1, 64);
        /// What the network predicts.
        prediction: Prediction = Prediction::Chunk, Prediction::shape();
    }
}

/// Every setting of such a policy.
pub(super) fn schema() -> Vec<Setting> {
    [observer::schema(), ChunkSpec::schema(), DrawSpec::schema()].concat()
}

/// A chunk mixed with noise, and what the network has to predict from it; all `[R, k, A]`.
pub(super) struct Mixed {
    pub(super) noisy: Tensor,
    pub(super) target: Tensor,
}

/// How noise is added in training and removed in acting. Chunks are in units in which noise is N(0, 1).
pub(super) trait Process: Send {
    /// Actions `[…, A]` in physical units as chunks.
    fn scaled(&self, statistics: &Statistics, action: &Tensor) -> Tensor;

    /// Chunks as standardised actions.
    fn standardised(&self, statistics: &Statistics, chunk: Tensor) -> Tensor;

    /// A time of training in 0 … 1, of a number drawn from 0 … 1.
    fn time(&self, uniform: f64) -> f64;

    /// Chunks and noise `[R, k, A]` mixed at times `[R, 1, 1]`.
    fn mix(&self, chunk: &Tensor, noise: &Tensor, time: &Tensor) -> Mixed;

    /// Noise `[W, k, A]` to chunks in this many passes of `predict`, the network at one time.
    fn draw(&self, noise: &Tensor, passes: u32, predict: &dyn Fn(&Tensor, f64) -> Tensor) -> Tensor;

    /// What is to be removed from noisy chunks `[W, k, A]` at one time if these are the chunks without noise: in the unit
    /// of [`Mixed::target`].
    fn removal(&self, noisy: &Tensor, chunk: &Tensor, time: f64) -> Tensor;

    /// Values that a checkpoint keeps.
    fn constants(&self) -> Vec<(String, Tensor)> {
        Vec::new()
    }
}

/// A policy that predicts, from a noisy chunk, what to remove from it.
struct Denoiser<P> {
    process: P,
    observer: Observer,
    chunk: ChunkSpec,
    draw: DrawSpec,
    network: Network,
}

/// The policy before its first step.
pub(super) fn init(process: impl Process + 'static, from: &PolicyInit<'_>, info: &CheckpointInfo) -> NewPolicy {
    let denoiser = Denoiser::new(process, Observer::init(from, info)?, info)?;
    denoiser.observer.draw(from, info)?;
    Ok(Box::new(denoiser))
}

/// The policy with the weights of a checkpoint.
pub(super) fn load(
    process: impl Process + 'static,
    info: &CheckpointInfo,
    named: &BTreeMap<String, Tensor>,
    device: Device,
) -> NewPolicy {
    let denoiser = Denoiser::new(process, Observer::load(info, named, device)?, info)?;
    denoiser.observer.take(named)?;
    Ok(Box::new(denoiser))
}

impl<P: Process> Denoiser<P> {
    fn new(process: P, observer: Observer, info: &CheckpointInfo) -> Result<Self, LearnError> {
        let (chunk, draw): (ChunkSpec, DrawSpec) = (info.settings()?, info.settings()?);
        let root = observer.root();
        let network = Network::new(&root, &observer, chunk.chunk_length.into(), chunk.chunk_network);
        drop(root);
        Ok(Self { process, observer, chunk, draw, network })
    }

    fn memory(&self, input: &PolicyInput) -> Tensor {
        let Encoded { images, proprioception } = self.observer.encoded(input);
        self.network.memory(&images, &proprioception)
    }
}

impl<P: Process> PolicyModel for Denoiser<P> {
    fn info(&self) -> PolicyInfo<'_> {
        self.observer.info(self.chunk.chunk_length as usize)
    }

    fn horizon(&self) -> u32 {
        self.chunk.horizon()
    }

    fn history(&self) -> HistorySpec {
        self.observer.history()
    }

    fn parameters(&self) -> Vec<(String, Tensor)> {
        self.observer.parameters()
    }

    fn constants(&self) -> Vec<(String, Tensor)> {
        self.process.constants()
    }

    fn encode(&self, images: &[Tensor]) -> Tensor {
        self.observer.encode(images)
    }

    /// The squared errors of the network, the mean over the pairs of noise and time of each segment.
    fn losses(&self, input: &PolicyInput, wanted: &Chunks, rng: &mut ChaCha8Rng) -> Losses {
        let pairs = i64::from(self.draw.noise_pairs);
        let each = |of_segments: &Tensor| of_segments.repeat_interleave_self_int(pairs, 0, None);
        // 0 where the action does not count.
        let chunk = self.process.scaled(self.observer.statistics(), &wanted.action) * wanted.counted.unsqueeze(-1);
        let (chunk, counted) = (each(&chunk), each(&wanted.counted));
        let (mut noise, mut times) = (Vec::with_capacity(chunk.numel()), Vec::new());
        let mut draw = || (normal(rng, chunk.get(0).numel()), self.process.time(rng.random()));
        // Those of the windows before these.
        (0..input.before * self.draw.noise_pairs as usize).for_each(|_| drop(draw()));
        while noise.len() < chunk.numel() {
            let (drawn, time) = draw();
            noise.extend(drawn);
            times.push(time);
        }
        let like = |numbers: Tensor| numbers.to_kind(chunk.kind()).to(chunk.device());
        let noise = like(Tensor::from_slice(&noise)).view_as(&chunk);
        let times = like(Tensor::from_slice(&times)).view([-1, 1, 1]);
        let Mixed { noisy, target } = self.process.mix(&chunk, &noise, &times);
        let target = match self.draw.prediction {
            Prediction::Noise => target,
            Prediction::Chunk => chunk,
        };
        let found = self.network.forward(&each(&self.memory(input)), &noisy, &times, Some(&counted));
        let errors = (found - target).square().mean_dim([-1i64].as_slice(), false, None);
        let of_pairs = (errors * counted).mean_dim([-1i64].as_slice(), false, None);
        let each = of_pairs.view([-1, pairs]).mean_dim([-1i64].as_slice(), false, None);
        Losses { each, parts: Vec::new() }
    }

    fn act(&self, input: &PolicyInput) -> Tensor {
        let memory = self.memory(input);
        let predict = |noisy: &Tensor, time: f64| {
            let times = Tensor::full([noisy.size()[0], 1, 1], time, (noisy.kind(), noisy.device()));
            let found = self.network.forward(&memory, noisy, &times, None);
            match self.draw.prediction {
                Prediction::Noise => found,
                Prediction::Chunk => self.process.removal(noisy, &found, time),
            }
        };
        let noise = input.noise([self.chunk.chunk_length.into(), self.observer.action()]);
        let drawn = self.process.draw(&noise, self.draw.sampling_steps, &predict);
        self.process.standardised(self.observer.statistics(), drawn)
    }
}
