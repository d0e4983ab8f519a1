//! The policy `act`: action chunking with transformers (Zhao et al. 2023), a conditional VAE over
//! chunks a_t … a_{t+k−1} given o_t and m_t.
//!
//! The images are one embedding beside which the queries of the chunk stand, or, as in the paper, a grid of tokens: a
//! transformer encoder reads z, m_t and the tokens of all cameras, and a decoder's queries attend to its output; or a
//! perceptron reads one embedding, m_t and z. Unlike
//! the paper's, norms come before attention, positions are added once, and there is no dropout.
//!
//! Training: a style encoder reads m_t and the chunk and returns q(z | m, a) = N(μ, σ²); a decoder predicts the chunk
//! from o_t, m_t and z. The loss is L1 + kl_weight · KL(q ‖ N(0, 1)), L1 the mean over the chunk's k places of the
//! standardised actions' absolute errors. Acting: z = 0; chunks are ensembled, or executed one after the other.
//!
//! A place of the chunk beyond the episode's end does not count. In an imperfect episode no place counts from the first
//! step on whose segment was not kept: the actions there were scored too low to imitate, and a chunk must not include
//! them. Places that do not count are hidden from the style encoder and cost nothing. The sum is always divided by k,
//! so that an action has the same weight in every chunk that contains it. A chunk's weight is the q of its first step.

mod grid;
mod layers;

use std::collections::BTreeMap;

use gleaner_core::kinds::Needs;
use gleaner_core::schema::{integer_in, number_in};
use gleaner_core::{Group as _, ModelSpec, OptimSpec, Words as _};
use rand_chacha::ChaCha8Rng;
use tch::{Device, Kind, Tensor};

use super::chunk::{ChunkNetwork, ChunkSpec};
use super::hiding::HistorySpec;
use super::kind::{Losses, NewPolicy, PolicyInfo, PolicyInit, PolicyInput, PolicyKind, PolicyModel};
use super::observer::{self, Encoded, ImageTokens, ImagesSpec, Observer};
use crate::batch::Chunks;
use crate::checkpoint::CheckpointInfo;
use crate::error::LearnError;
use crate::random::normal;
use grid::GridDecoder;
use layers::{ChunkDecoder, ChunkPerceptron, Lengths, StyleEncoder};

pub(super) const KIND: PolicyKind = PolicyKind {
    name: "act",
    title: "ACT",
    about: "Action chunking with transformers: a conditional VAE that predicts chunks of actions.",
    needs: Needs { encoder: false, history: false, images: true, all_episodes: false },
    settings: || [observer::schema(), ImagesSpec::schema(), ChunkSpec::schema(), ActSpec::schema()].concat(),
    optim: OptimSpec::default,
    model,
    init,
    load,
};

gleaner_core::words! {
    /// Execution of a chunk whose successors may be predicted before its end.
    pub(super) enum ChunkExecution {
        /// A chunk is predicted at every step, and the mean of all predictions for a time is executed, as in the paper:
        /// smooth, and late to react where predictions differ.
        Ensembled = "ensembled",
        /// The first execute_length actions of a chunk are executed before the next is predicted: fewer passes, and
        /// every action is one that the policy predicted.
        Horizon = "horizon",
    }
}

gleaner_core::settings! {
    /// Settings of ACT.
    #[derive(Copy)]
    pub(super) struct ActSpec {
        /// Weight of the KL divergence of the style z from N(0, 1) (0: z is not regularised). Higher values make
        /// actions depend less on z.
        pub(super) kl_weight: f64 = 10.0, number_in(0.0, 1e6);
        /// Size of the style z. Larger sizes encode more variation between demonstrations.
        pub(super) latent_size: u32 = 16, integer_in(1, 1024);
        /// Execution of chunks.
        pub(super) chunk_execution: ChunkExecution = ChunkExecution::Horizon, ChunkExecution::shape();
    }
}

fn model(from: &PolicyInit<'_>) -> Result<ModelSpec, LearnError> {
    let (ImagesSpec { image_tokens }, ChunkSpec { chunk_network, .. }) = (from.chosen().read()?, from.chosen().read()?);
    if image_tokens == ImageTokens::Grid && chunk_network == ChunkNetwork::Perceptron {
        let message =
            "is perceptron, which reads one embedding, but image_tokens is grid; use transformer, or embedding";
        return Err(LearnError::invalid("chunk_network", message));
    }
    observer::model(from)
}

fn init(from: &PolicyInit<'_>, info: &CheckpointInfo) -> NewPolicy {
    let policy = Act::new(Observer::init(from, info)?, info)?;
    policy.observer.draw(from, info)?;
    Ok(Box::new(policy))
}

fn load(info: &CheckpointInfo, named: &BTreeMap<String, Tensor>, device: Device) -> NewPolicy {
    let policy = Act::new(Observer::load(info, named, device)?, info)?;
    policy.observer.take(named)?;
    Ok(Box::new(policy))
}

/// The network that predicts a chunk.
enum Decoder {
    /// Queries beside one embedding of the images.
    Embedding(ChunkDecoder),
    /// An encoder and a decoder over the images' tokens, as in the paper.
    Grid(GridDecoder),
    /// A perceptron of one embedding of the images.
    Perceptron(ChunkPerceptron),
}

impl Decoder {
    /// Encoded images `[W, d]` or `[W, T d]`, encoded m `[W, P]` and z `[W, Z]` to the standardised chunk `[W, k, A]`.
    fn forward(&self, o: &Tensor, m: &Tensor, z: &Tensor) -> Tensor {
        match self {
            Self::Embedding(decoder) => decoder.forward(o, m, z),
            Self::Grid(decoder) => decoder.forward(o, m, z),
            Self::Perceptron(decoder) => decoder.forward(o, m, z),
        }
    }
}

struct Act {
    observer: Observer,
    chunk: ChunkSpec,
    spec: ActSpec,
    style: StyleEncoder,
    decoder: Decoder,
}

impl Act {
    fn new(observer: Observer, info: &CheckpointInfo) -> Result<Self, LearnError> {
        let (chunk, spec): (ChunkSpec, ActSpec) = (info.settings()?, info.settings()?);
        let lengths = Lengths {
            proprioception: observer.proprioception(),
            action: observer.action(),
            chunk: chunk.chunk_length.into(),
            latent: spec.latent_size.into(),
        };
        let root = observer.root();
        let style = StyleEncoder::new(&(&root / "style"), lengths, &observer.size);
        let path = &root / "decoder";
        let decoder = match (info.settings::<ImagesSpec>()?.image_tokens, chunk.chunk_network) {
            (ImageTokens::Grid, _) => Decoder::Grid(GridDecoder::new(&path, lengths, &observer.size)),
            (ImageTokens::Embedding, ChunkNetwork::Transformer) => {
                Decoder::Embedding(ChunkDecoder::new(&path, lengths, &observer.size))
            }
            (ImageTokens::Embedding, ChunkNetwork::Perceptron) => {
                Decoder::Perceptron(ChunkPerceptron::new(&path, lengths, &observer.size))
            }
        };
        drop(root);
        Ok(Self { observer, chunk, spec, style, decoder })
    }
}

impl PolicyModel for Act {
    fn info(&self) -> PolicyInfo<'_> {
        self.observer.info(self.chunk.chunk_length as usize)
    }

    fn horizon(&self) -> u32 {
        match self.spec.chunk_execution {
            ChunkExecution::Ensembled => 0,
            ChunkExecution::Horizon => self.chunk.horizon(),
        }
    }

    fn history(&self) -> HistorySpec {
        self.observer.history()
    }

    fn parameters(&self) -> Vec<(String, Tensor)> {
        self.observer.parameters()
    }

    fn encode(&self, images: &[Tensor]) -> Tensor {
        self.observer.encode(images)
    }

    fn losses(&self, input: &PolicyInput, wanted: &Chunks, rng: &mut ChaCha8Rng) -> Losses {
        let Encoded { images: o, proprioception: m } = self.observer.encoded(input);
        let target = self.observer.statistics().action.apply(&wanted.action);
        let (mean, log_variance) = self.style.forward(&m, &target, &wanted.counted);
        // Drawn for the windows before these, too.
        let before = input.before * mean.get(0).numel();
        let noise = normal(rng, before + mean.numel());
        let noise = Tensor::from_slice(&noise[before..]).view_as(&mean).to_device(mean.device());
        let z = &mean + (&log_variance * 0.5).exp() * noise;
        let errors = (self.decoder.forward(&o, &m, &z) - target).abs().mean_dim([-1i64].as_slice(), false, None);
        let errors = (errors * &wanted.counted).mean_dim([-1i64].as_slice(), false, None);
        let divergence = divergence(&mean, &log_variance);
        Losses {
            each: &errors + &divergence * self.spec.kl_weight,
            parts: vec![("loss_l1", errors), ("loss_kl", divergence)],
        }
    }

    fn act(&self, input: &PolicyInput) -> Tensor {
        let Encoded { images: o, proprioception: m } = self.observer.encoded(input);
        let z = Tensor::zeros([o.size()[0], i64::from(self.spec.latent_size)], (Kind::Float, o.device()));
        self.decoder.forward(&o, &m, &z)
    }
}

/// KL(N(μ, σ²) ‖ N(0, 1)) of each row, summed over the style's values: `[W, Z]` to `[W]`.
fn divergence(mean: &Tensor, log_variance: &Tensor) -> Tensor {
    let each = (mean.square() + log_variance.exp() - log_variance - 1.0) * 0.5;
    each.sum_dim_intlist([-1i64].as_slice(), false, None)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::batch::values;

    #[test]
    fn the_divergence_is_that_of_two_normals() {
        let mean = Tensor::from_slice(&[0.0f32, 0.0, 1.0, -2.0]).view([2, 2]);
        let log_variance = Tensor::from_slice(&[0.0f32, 0.0, 0.0, 4f32.ln()]).view([2, 2]);
        let found = values(&divergence(&mean, &log_variance));
        assert_eq!(found[0], 0.0);
        // 1/2 + (4 + 4 - 1 - ln 4) / 2.
        assert!((found[1] - (0.5 + (7.0 - 4f32.ln()) / 2.0)).abs() < 1e-6);
    }
}
