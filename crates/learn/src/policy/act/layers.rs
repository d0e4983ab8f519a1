//! ACT's two networks, built of the transformer's blocks: plain layers and their shapes.

use tch::nn::{self, Module};
use tch::{Kind, Tensor};

use crate::model::{Perceptron, Size, Transformer};

/// Sizes of ACT's parts.
#[derive(Clone, Copy)]
pub(super) struct Lengths {
    /// Values of encoded proprioception, P.
    pub(super) proprioception: i64,
    /// Values of an action, A.
    pub(super) action: i64,
    /// Actions of a chunk, k.
    pub(super) chunk: i64,
    /// Values of the style z.
    pub(super) latent: i64,
}

/// Tokens that the decoder attends to: o, m and z.
const MEMORY: i64 = 3;

/// q(z | m, a): reads m_t and the chunk, and summarises them in a separate token.
pub(super) struct StyleEncoder {
    proprioception: nn::Linear,
    action: nn::Linear,
    /// `[1, d]`: the summary token.
    summary: Tensor,
    /// `[k + 2, d]`: m, the chunk's places, the summary.
    place: Tensor,
    transformer: Transformer,
    out: nn::Linear,
}

impl StyleEncoder {
    pub(super) fn new(path: &nn::Path<'_>, lengths: Lengths, size: &Size) -> Self {
        let linear = |name: &str, from, to| nn::linear(path / name, from, to, Default::default());
        Self {
            proprioception: linear("proprioception", lengths.proprioception, size.width),
            action: linear("action", lengths.action, size.width),
            summary: path.zeros("summary_embedding", &[1, size.width]),
            place: path.zeros("place_embedding", &[lengths.chunk + 2, size.width]),
            transformer: Transformer::new(&(path / "transformer"), size),
            out: linear("out", size.width, 2 * lengths.latent),
        }
    }

    /// Encoded m `[W, P]` and standardised chunk `[W, k, A]`, of which only the places that are `counted` `[W, k]` are input,
    /// to the mean and the logarithm of the variance of z, `[W, Z]` each.
    pub(super) fn forward(&self, m: &Tensor, chunk: &Tensor, counted: &Tensor) -> (Tensor, Tensor) {
        let m = self.proprioception.forward(m).unsqueeze(1);
        let summary = self.summary.expand_as(&m);
        let tokens = Tensor::cat(&[m, self.action.forward(chunk), summary], 1) + &self.place;
        let always = counted.ones_like().narrow(1, 0, 1);
        let keys = Tensor::cat(&[&always, counted, &always], 1);
        let (windows, length) = (keys.size()[0], keys.size()[1]);
        let mask = keys.view([windows, 1, 1, length]).expand([windows, 1, length, length], false);
        let input = self.transformer.last_tokens(&tokens, Some(&mask), 1).squeeze_dim(1);
        let halves = self.out.forward(&input).chunk(2, -1);
        (halves[0].shallow_clone(), halves[1].shallow_clone())
    }
}

/// Predicts a chunk: k learnt queries attend to o, m and z, and to each other.
pub(super) struct ChunkDecoder {
    proprioception: nn::Linear,
    style: nn::Linear,
    /// `[3, d]`: the embeddings that distinguish o, m and z.
    memory: Tensor,
    /// `[k, d]`.
    query: Tensor,
    transformer: Transformer,
    out: nn::Linear,
}

impl ChunkDecoder {
    pub(super) fn new(path: &nn::Path<'_>, lengths: Lengths, size: &Size) -> Self {
        let linear = |name: &str, from, to| nn::linear(path / name, from, to, Default::default());
        Self {
            proprioception: linear("proprioception", lengths.proprioception, size.width),
            style: linear("style", lengths.latent, size.width),
            memory: path.zeros("memory_embedding", &[MEMORY, size.width]),
            query: path.zeros("query_embedding", &[lengths.chunk, size.width]),
            transformer: Transformer::new(&(path / "transformer"), size),
            out: linear("out", size.width, lengths.action),
        }
    }

    /// Embedded o `[W, d]`, encoded m `[W, P]` and z `[W, Z]` to the standardised chunk
    /// `[W, k, A]`.
    pub(super) fn forward(&self, o: &Tensor, m: &Tensor, z: &Tensor) -> Tensor {
        let memory = Tensor::stack(&[o, &self.proprioception.forward(m), &self.style.forward(z)], 1) + &self.memory;
        let chunk = self.query.size()[0];
        let query = self.query.unsqueeze(0).expand([o.size()[0], -1, -1], false);
        let all = MEMORY + chunk;
        let mask = Tensor::ones([1, 1, all, all], (Kind::Bool, o.device()));
        let tokens = Tensor::cat(&[memory, query], 1);
        self.out.forward(&self.transformer.last_tokens(&tokens, Some(&mask), chunk))
    }
}

/// Predicts a chunk by a perceptron of o, m and z.
pub(super) struct ChunkPerceptron {
    perceptron: Perceptron,
    chunk: i64,
}

impl ChunkPerceptron {
    pub(super) fn new(path: &nn::Path<'_>, lengths: Lengths, size: &Size) -> Self {
        let inputs = size.width + lengths.proprioception + lengths.latent;
        let perceptron = Perceptron::new(path, inputs, Perceptron::WIDE * size.width, lengths.chunk * lengths.action);
        Self { perceptron, chunk: lengths.chunk }
    }

    /// As [`ChunkDecoder::forward`].
    pub(super) fn forward(&self, o: &Tensor, m: &Tensor, z: &Tensor) -> Tensor {
        self.perceptron.forward(&Tensor::cat(&[o, m, z], 1)).unflatten(1, [self.chunk, -1])
    }
}
