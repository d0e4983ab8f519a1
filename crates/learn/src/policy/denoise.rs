//! Policies that draw a chunk by removing noise from it step by step: their common settings, network and loss. A
//! drawn chunk is a sample of P(a_t … a_{t+k−1} | o_t, m_t), so several right ways to act are not averaged into a wrong one.
//! Independent of the schedule of the noise.
//!
//! A place of a chunk that does not count, as in ACT, costs nothing and is hidden from the other places.

mod network;

use std::collections::BTreeMap;

use gleaner_core::schema::integer_in;
use gleaner_core::{Group as _, Setting};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use tch::{Device, Tensor};

use super::chunk::ChunkSpec;
use super::kind::{Losses, PolicyInfo, PolicyInit, PolicyInput};
use super::observer::{self, Encoded, Observer};
use crate::batch::Chunks;
use crate::checkpoint::CheckpointInfo;
use crate::error::LearnError;
use crate::random::normal;
use network::Network;

gleaner_core::settings! {
    /// Settings of a policy that draws its chunks from noise.
    #[derive(Copy)]
    struct DrawSpec {
        /// Number of actions executed of each chunk before the next one is predicted; at most chunk_length. Larger
        /// numbers cost less and react later.
        execute_length: u32 = 5, integer_in(1, 256);
        /// Number of passes of the network that remove the noise from a chunk. More passes draw more exactly and take
        /// longer.
        sampling_steps: u32 = 10, integer_in(1, 1000);
        /// Pairs of noise and time for each segment of a batch. More pairs give a smoother loss at little cost, because
        /// they share the segment's image.
        noise_pairs: u32 = 4, integer_in(1, 64);
    }
}

/// Every setting of such a policy.
pub(super) fn schema() -> Vec<Setting> {
    [observer::schema(), ChunkSpec::schema(), DrawSpec::schema()].concat()
}

/// A policy that predicts, from a noisy chunk, what to remove from it.
pub(super) struct Denoiser {
    pub(super) observer: Observer,
    chunk: ChunkSpec,
    draw: DrawSpec,
    network: Network,
}

/// A chunk mixed with noise, and what the network has to predict from it; all `[R, k, A]`.
pub(super) struct Mixed {
    pub(super) noisy: Tensor,
    pub(super) target: Tensor,
}

impl Denoiser {
    /// Before its first step.
    pub(super) fn init(from: &PolicyInit<'_>, info: &CheckpointInfo) -> Result<Self, LearnError> {
        let denoiser = Self::new(Observer::init(from, info)?, info)?;
        denoiser.observer.draw(from, info)?;
        Ok(denoiser)
    }

    pub(super) fn load(
        info: &CheckpointInfo,
        named: &BTreeMap<String, Tensor>,
        device: Device,
    ) -> Result<Self, LearnError> {
        let denoiser = Self::new(Observer::load(info, named, device)?, info)?;
        denoiser.observer.take(named)?;
        Ok(denoiser)
    }

    fn new(observer: Observer, info: &CheckpointInfo) -> Result<Self, LearnError> {
        let (chunk, draw): (ChunkSpec, DrawSpec) = (info.settings()?, info.settings()?);
        let root = observer.root();
        let network = Network::new(&root, &observer, chunk.chunk_length.into());
        drop(root);
        Ok(Self { observer, chunk, draw, network })
    }

    pub(super) fn info(&self) -> PolicyInfo<'_> {
        self.observer.info(self.chunk.chunk_length as usize)
    }

    pub(super) fn horizon(&self) -> u32 {
        self.draw.execute_length.min(self.chunk.chunk_length)
    }

    pub(super) fn sampling_steps(&self) -> u32 {
        self.draw.sampling_steps
    }

    /// The squared errors of the network on chunks `[W, k, A]`, in the units in which noise is N(0, 1), mixed with noise by
    /// `mix` (chunk, noise, time `[R, 1, 1]`) at times 0 … 1 that `time` makes of numbers in 0 … 1.
    pub(super) fn losses(
        &self,
        input: &PolicyInput,
        (chunk, wanted): (&Tensor, &Chunks),
        rng: &mut ChaCha8Rng,
        time: impl Fn(f64) -> f64,
        mix: impl Fn(&Tensor, &Tensor, &Tensor) -> Mixed,
    ) -> Losses {
        let pairs = i64::from(self.draw.noise_pairs);
        let each = |of_segments: &Tensor| of_segments.repeat_interleave_self_int(pairs, 0, None);
        let (chunk, counted) = (each(chunk), each(&wanted.counted));
        let (mut noise, mut times) = (Vec::with_capacity(chunk.numel()), Vec::new());
        while noise.len() < chunk.numel() {
            noise.extend(normal(rng, chunk.get(0).numel()));
            times.push(time(rng.random()));
        }
        let like = |numbers: Tensor| numbers.to_kind(chunk.kind()).to(chunk.device());
        let noise = like(Tensor::from_slice(&noise)).view_as(&chunk);
        let times = like(Tensor::from_slice(&times)).view([-1, 1, 1]);
        let Mixed { noisy, target } = mix(&chunk, &noise, &times);
        let memory = each(&self.memory(input));
        let found = self.network.forward(&memory, &noisy, &times, Some(&counted));
        let errors = (found - target).square().mean_dim([-1i64].as_slice(), false, None);
        let of_pairs = (errors * counted).mean_dim([-1i64].as_slice(), false, None);
        let each = of_pairs.view([-1, pairs]).mean_dim([-1i64].as_slice(), false, None);
        Losses { each, parts: Vec::new() }
    }

    /// The prediction for chunks `[W, k, A]` at one time, by the passes of one acting step.
    pub(super) fn predictor(&self, input: &PolicyInput) -> impl Fn(&Tensor, f64) -> Tensor {
        let memory = self.memory(input);
        move |noisy, time| {
            let time = Tensor::full([noisy.size()[0], 1, 1], time, (noisy.kind(), noisy.device()));
            self.network.forward(&memory, noisy, &time, None)
        }
    }

    /// N(0, 1) for each window's chunk, `[W, k, A]`.
    pub(super) fn noise(&self, input: &PolicyInput) -> Tensor {
        input.noise([self.chunk.chunk_length.into(), self.observer.action()])
    }

    fn memory(&self, input: &PolicyInput) -> Tensor {
        let Encoded { images, proprioception } = self.observer.encoded(input);
        self.network.memory(&images, &proprioception)
    }
}
