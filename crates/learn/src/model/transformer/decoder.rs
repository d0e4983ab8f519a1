//! A pre-norm transformer whose tokens attend to a memory too: the decoder of an encoder and a decoder. Independent of
//! what the tokens and the memory are.

use tch::Tensor;
use tch::nn::{self, Module};

use super::block::{Block, MultiHead};
use crate::model::Size;

/// A block with attention to a memory between its two halves.
struct MemoryBlock {
    block: Block,
    before_memory: nn::LayerNorm,
    memory: MultiHead,
}

impl MemoryBlock {
    fn new(path: &nn::Path<'_>, size: &Size) -> Self {
        Self {
            block: Block::new(path, size),
            before_memory: nn::layer_norm(path / "memory_norm", vec![size.width], Default::default()),
            memory: MultiHead::new(&(path / "memory"), size),
        }
    }

    /// Tokens `[W, Q, d]` and memory `[W, S, d]` to tokens `[W, Q, d]`.
    fn forward(&self, x: &Tensor, memory: &Tensor) -> Tensor {
        let x = self.block.attend(x, None, x.size()[1]);
        let seen = self.memory.forward(&self.before_memory.forward(&x), memory, None);
        self.block.feed(&(x + seen))
    }
}

/// The blocks and the last norm.
pub(crate) struct Decoder {
    blocks: Vec<MemoryBlock>,
    norm: nn::LayerNorm,
}

impl Decoder {
    pub(crate) fn new(path: &nn::Path<'_>, size: &Size) -> Self {
        let blocks = (0..size.layers).map(|i| MemoryBlock::new(&(path / "block" / i), size)).collect();
        Self { blocks, norm: nn::layer_norm(path / "norm", vec![size.width], Default::default()) }
    }

    /// Tokens `[W, Q, d]`, each of which attends to all of them and to all of a memory `[W, S, d]`, to features
    /// `[W, Q, d]`. The memory comes after a norm, as a [`Transformer`](super::Transformer) returns it.
    pub(crate) fn forward(&self, tokens: &Tensor, memory: &Tensor) -> Tensor {
        let features = self.blocks.iter().fold(tokens.shallow_clone(), |x, block| block.forward(&x, memory));
        self.norm.forward(&features)
    }
}

#[cfg(test)]
mod tests {
    use gleaner_core::Preset;
    use tch::{Device, Kind};

    use super::*;
    use crate::model::weights;
    use crate::toy;

    fn difference(a: &Tensor, b: &Tensor) -> f64 {
        (a - b).abs().max().double_value(&[])
    }

    #[test]
    fn every_token_reads_all_of_the_memory_and_all_tokens_and_no_other_window() {
        let store = nn::VarStore::new(Device::Cpu);
        let size = Size::of(Preset::Tiny);
        let decoder = Decoder::new(&store.root(), &size);
        weights::draw(&weights::sorted(&store), 1.0, 1);
        let (tokens, memory) = (toy::numbers(&[2, 3, 64], 1), toy::numbers(&[2, 5, 64], 2));
        let plain = decoder.forward(&tokens, &memory);
        assert_eq!(plain.size(), [2, 3, 64]);
        let changed = |place: &dyn Fn() -> [Tensor; 2]| {
            let [tokens, memory] = place();
            decoder.forward(&tokens, &memory)
        };
        // One changed value of the first window: every token of that window changes, and none of the other.
        let with = |x: &Tensor, at: i64| {
            let changed = x.copy();
            let _ = changed.narrow(0, 0, 1).narrow(1, at, 1).narrow(2, 0, 1).g_add_scalar_(1.0);
            changed
        };
        for at in 0..5 {
            let found = changed(&|| [tokens.copy(), with(&memory, at)]);
            assert!((0..3).all(|token| difference(&found.get(0).get(token), &plain.get(0).get(token)) > 1e-5), "{at}");
            assert!(difference(&found.get(1), &plain.get(1)) < 1e-6);
        }
        for at in 0..3 {
            let found = changed(&|| [with(&tokens, at), memory.copy()]);
            assert!((0..3).all(|token| difference(&found.get(0).get(token), &plain.get(0).get(token)) > 1e-5), "{at}");
        }
        // A memory is a set: its order has no meaning without positions.
        let turned = decoder.forward(&tokens, &memory.flip([1]));
        assert!(difference(&turned, &plain) < 1e-5);
        assert_eq!(plain.kind(), Kind::Float);
    }
}
