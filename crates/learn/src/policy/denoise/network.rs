//! The networks of policies that remove noise: a transformer over o, m and the places of a noisy chunk, or a perceptron of
//! all their numbers. Plain layers and their shapes.

use tch::nn::{self, Module};
use tch::{Kind, Tensor};

use crate::model::{Perceptron, Transformer, Waves};
use crate::policy::chunk::ChunkNetwork;
use crate::policy::observer::Observer;

/// Tokens that the chunk's places attend to: o and m.
const MEMORY: i64 = 2;
/// The shortest and the longest period of the waves that represent a time in 0 … 1.
const PERIODS: [f64; 2] = [4e-3, 4.0];

/// Width of the perceptron's hidden layers, as a multiple of that in behaviour cloning, which has no chunk to read.
const WIDER: i64 = 2;

/// A network that predicts, from a noisy chunk, what to remove from it, or the chunk without noise.
pub(super) enum Network {
    Transformer(Box<Tokens>),
    Perceptron(Numbers),
}

impl Network {
    pub(super) fn new(path: &nn::Path<'_>, observer: &Observer, chunk: i64, kind: ChunkNetwork) -> Self {
        match kind {
            ChunkNetwork::Transformer => Self::Transformer(Box::new(Tokens::new(path, observer, chunk))),
            ChunkNetwork::Perceptron => Self::Perceptron(Numbers::new(path, observer, chunk)),
        }
    }

    /// What a chunk is predicted from, of encoded o `[W, d]` and m `[W, P]`: `[W, …]`.
    pub(super) fn memory(&self, o: &Tensor, m: &Tensor) -> Tensor {
        match self {
            Self::Transformer(network) => network.memory(o, m),
            Self::Perceptron(_) => Tensor::cat(&[o, m], 1),
        }
    }

    /// Memory `[R, …]`, noisy chunks `[R, k, A]` and their times `[R, 1, 1]` in 0 … 1 to predictions `[R, k, A]`. Only
    /// places that are `counted` `[R, k]` have an effect on others; `None`: all have.
    pub(super) fn forward(&self, memory: &Tensor, noisy: &Tensor, time: &Tensor, counted: Option<&Tensor>) -> Tensor {
        match self {
            Self::Transformer(network) => network.forward(memory, noisy, time, counted),
            Self::Perceptron(network) => network.forward(memory, noisy, time, counted),
        }
    }
}

/// The embedding of a time.
struct Time {
    waves: Waves,
    layers: [nn::Linear; 2],
}

impl Time {
    fn new(path: &nn::Path<'_>, width: i64) -> Self {
        let linear = |name: &str| nn::linear(path / name, width, width, Default::default());
        Self { waves: Waves::new(PERIODS, width, path.device()), layers: [linear("time_hidden"), linear("time_out")] }
    }

    /// Times `[R, 1, 1]` to `[R, d]`.
    fn embedded(&self, time: &Tensor) -> Tensor {
        let waves = self.waves.of(&time.squeeze_dim(-1));
        self.layers[1].forward(&self.layers[0].forward(&waves).silu())
    }
}

/// A perceptron of o, m, the time and all numbers of the noisy chunk.
pub(super) struct Numbers {
    time: Time,
    perceptron: Perceptron,
}

impl Numbers {
    fn new(path: &nn::Path<'_>, observer: &Observer, chunk: i64) -> Self {
        let (d, numbers) = (observer.size.width, chunk * observer.action());
        let inputs = 2 * d + observer.proprioception() + numbers;
        let wide = WIDER * Perceptron::WIDE * d;
        Self { time: Time::new(path, d), perceptron: Perceptron::new(path, inputs, wide, numbers) }
    }

    fn forward(&self, memory: &Tensor, noisy: &Tensor, time: &Tensor, counted: Option<&Tensor>) -> Tensor {
        let time = self.time.embedded(time);
        let seen = counted.map_or_else(|| noisy.shallow_clone(), |counted| noisy * counted.unsqueeze(-1));
        self.perceptron.forward(&Tensor::cat(&[memory, &time, &seen.flatten(1, 2)], 1)).view_as(noisy)
    }
}

/// A transformer over o, m and the places of the noisy chunk.
pub(super) struct Tokens {
    proprioception: nn::Linear,
    action: nn::Linear,
    time: Time,
    /// `[2, d]`: the embeddings that distinguish o and m.
    memory: Tensor,
    /// `[k, d]`.
    place: Tensor,
    transformer: Transformer,
    out: nn::Linear,
    /// `[1, 1, 2 + k, 2 + k]` of `bool`, true where the query (row) may attend to the key (column): o and m to each other,
    /// places of the chunk to all.
    mask: Tensor,
}

impl Tokens {
    fn new(path: &nn::Path<'_>, observer: &Observer, chunk: i64) -> Self {
        let size = &observer.size;
        let linear = |name: &str, from, to| nn::linear(path / name, from, to, Default::default());
        let (d, device) = (size.width, path.device());
        let all = MEMORY + chunk;
        let mask = Tensor::ones([all, all], (Kind::Bool, device));
        let _ = mask.narrow(0, 0, MEMORY).narrow(1, MEMORY, chunk).fill_(0);
        Self {
            proprioception: linear("proprioception", observer.proprioception(), d),
            action: linear("action", observer.action(), d),
            time: Time::new(path, d),
            memory: path.zeros("memory_embedding", &[MEMORY, d]),
            place: path.zeros("place_embedding", &[chunk, d]),
            transformer: Transformer::new(&(path / "transformer"), size),
            out: linear("out", d, observer.action()),
            mask: mask.unsqueeze(0).unsqueeze(0),
        }
    }

    /// Encoded o `[W, d]` and m `[W, P]` to the tokens that a chunk is predicted from, `[W, 2, d]`.
    fn memory(&self, o: &Tensor, m: &Tensor) -> Tensor {
        Tensor::stack(&[o, &self.proprioception.forward(m)], 1) + &self.memory
    }

    fn forward(&self, memory: &Tensor, noisy: &Tensor, time: &Tensor, counted: Option<&Tensor>) -> Tensor {
        let time = self.time.embedded(time).unsqueeze(1);
        let places = self.action.forward(noisy) + time + &self.place;
        let tokens = Tensor::cat(&[memory, &places], 1);
        let chunk = noisy.size()[1];
        let mask = match counted {
            None => self.mask.shallow_clone(),
            Some(counted) => {
                let always = Tensor::ones([counted.size()[0], MEMORY], (Kind::Bool, counted.device()));
                let keys = Tensor::cat(&[&always, counted], 1).unsqueeze(1).unsqueeze(1);
                let own = Tensor::eye(MEMORY + chunk, (Kind::Bool, counted.device()));
                self.mask.logical_and(&keys).logical_or(&own)
            }
        };
        self.out.forward(&self.transformer.last_tokens(&tokens, Some(&mask), chunk))
    }
}
