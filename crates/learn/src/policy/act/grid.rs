//! ACT's encoder and decoder over a grid of image tokens: plain layers and their shapes. Independent of the loss, and of
//! the images behind the tokens.

use tch::Tensor;
use tch::nn::{self, Module};

use super::layers::Lengths;
use crate::model::{Decoder, Size, Transformer};

/// Tokens of the encoder before those of the images: z and m.
const OBSERVED: i64 = 2;

/// Predicts a chunk: a transformer encoder over z, m and the images' tokens, and k learnt queries that attend to its
/// output and to each other.
pub(super) struct GridDecoder {
    style: nn::Linear,
    proprioception: nn::Linear,
    /// `[2, d]`: the embeddings that distinguish z and m.
    observed: Tensor,
    encoder: Transformer,
    /// `[k, d]`.
    query: Tensor,
    decoder: Decoder,
    out: nn::Linear,
}

impl GridDecoder {
    pub(super) fn new(path: &nn::Path<'_>, lengths: Lengths, size: &Size) -> Self {
        let linear = |name: &str, from, to| nn::linear(path / name, from, to, Default::default());
        Self {
            style: linear("style", lengths.latent, size.width),
            proprioception: linear("proprioception", lengths.proprioception, size.width),
            observed: path.zeros("observed_embedding", &[OBSERVED, size.width]),
            encoder: Transformer::new(&(path / "encoder"), size),
            query: path.zeros("query_embedding", &[lengths.chunk, size.width]),
            decoder: Decoder::new(&(path / "decoder"), size),
            out: linear("out", size.width, lengths.action),
        }
    }

    /// The images' tokens `[W, T d]`, one after the other, encoded m `[W, P]` and z `[W, Z]` to the standardised chunk
    /// `[W, k, A]`.
    pub(super) fn forward(&self, o: &Tensor, m: &Tensor, z: &Tensor) -> Tensor {
        let [queries, width] = [0, 1].map(|at| self.query.size()[at]);
        let observed = Tensor::stack(&[self.style.forward(z), self.proprioception.forward(m)], 1) + &self.observed;
        let tokens = Tensor::cat(&[observed, o.unflatten(1, [-1, width])], 1);
        let memory = self.encoder.last_tokens(&tokens, None, tokens.size()[1]);
        let query = self.query.unsqueeze(0).expand([o.size()[0], queries, width], false);
        self.out.forward(&self.decoder.forward(&query, &memory))
    }
}

#[cfg(test)]
mod tests {
    use gleaner_core::Preset;
    use tch::{Device, Kind};

    use super::*;
    use crate::model::{TokenGrid, weights};
    use crate::toy;

    const LENGTHS: Lengths = Lengths { proprioception: 3, action: 2, chunk: 4, latent: 5 };

    /// The largest change of a chunk.
    fn moved(a: &Tensor, b: &Tensor) -> f64 {
        (a - b).abs().max().double_value(&[])
    }

    #[test]
    fn a_chunk_depends_on_z_m_and_every_image_token_and_on_their_places_alone_not_their_order() {
        let store = nn::VarStore::new(Device::Cpu);
        let size = Size::of(Preset::Tiny);
        let decoder = GridDecoder::new(&(store.root() / "decoder"), LENGTHS, &size);
        let grid = TokenGrid::new(&(store.root() / "grid"), [[4, 8, 8], [4, 5, 7]].into_iter(), size.width);
        weights::draw(&weights::sorted(&store), 1.0, 1);
        let (maps, m, z) = (
            [toy::numbers(&[1, 4, 8, 8], 1), toy::numbers(&[1, 4, 5, 7], 1)],
            toy::numbers(&[1, 3], 1),
            toy::numbers(&[1, 5], 1),
        );
        let tokens = grid.forward(&maps);
        let act = |tokens: &Tensor, m: &Tensor, z: &Tensor| decoder.forward(&tokens.flatten(1, 2), m, z);
        let plain = act(&tokens, &m, &z);
        assert_eq!(plain.size(), [1, 4, 2]);
        assert!(moved(&act(&tokens, &(&m + 1.0), &z), &plain) > 1e-3);
        assert!(moved(&act(&tokens, &m, &(&z + 1.0)), &plain) > 1e-3);
        for token in 0..tokens.size()[1] {
            let changed = tokens.copy();
            let _ = changed.narrow(1, token, 1).fill_(0.0);
            assert!(moved(&act(&changed, &m, &z), &plain) > 1e-6, "token {token}");
        }
        // The same tokens in another order are the same places; the same contents at other places are not.
        assert!(moved(&act(&tokens.flip([1]), &m, &z), &plain) < 1e-5);
        for axis in [2, 3] {
            let turned = maps.each_ref().map(|map| map.flip([axis]));
            assert!(moved(&act(&grid.forward(&turned), &m, &z), &plain) > 1e-3);
        }
        assert_eq!(plain.kind(), Kind::Float);
    }
}
