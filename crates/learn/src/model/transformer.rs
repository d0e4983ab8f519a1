//! A pre-norm transformer over the tokens of a window, and its attention masks.

mod block;
mod decoder;

pub(crate) use decoder::Decoder;

use tch::nn::{self, Module};
use tch::{Device, Kind, Tensor};

use super::Size;
use super::tokens::MODALITIES;
use crate::batch::int;
use block::Block;

/// Attention between the tokens of a window.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Attention {
    /// Every token attends to every other.
    Bidirectional,
    /// A token attends to itself and those before it; m_t never attends to a_t.
    Causal,
    /// As causal, with a query after each step's m, to which no other token attends.
    Queried,
}

/// A query's place among a step's tokens o, m, query, a.
pub(super) const QUERY: i64 = 2;

impl Attention {
    /// Tokens of a step.
    fn tokens(self) -> i64 {
        MODALITIES + i64::from(self == Self::Queried)
    }
}

/// `[W, 1, 3 L, 3 L]`, or `4 L` with queries, of `bool`, true where the query (row) may attend to the key (column).
///
/// No token of the episode attends to padding. Every token attends to itself, because the softmax of a padded query
/// without any key would not be a number.
pub(crate) fn mask(valid: &Tensor, attention: Attention) -> Tensor {
    let keys = valid.repeat_interleave_self_int(attention.tokens(), 1, None);
    let size = keys.size()[1];
    let own = Tensor::eye(size, (Kind::Bool, valid.device()));
    let seen = keys.unsqueeze(1).unsqueeze(1);
    match attention {
        Attention::Bidirectional => seen.logical_or(&own),
        Attention::Causal | Attention::Queried => {
            let before = Tensor::ones([size, size], (Kind::Bool, valid.device())).tril(0);
            let mut seen = seen.logical_and(&before);
            if attention == Attention::Queried {
                let place = Tensor::arange(size, (Kind::Int64, valid.device())).remainder(attention.tokens());
                seen = seen.logical_and(&place.ne(QUERY));
            }
            seen.logical_or(&own)
        }
    }
}

/// As [`mask`], of windows of `length` steps without padding, one window, to be added to the input of a
/// softmax.
pub(super) fn whole_mask(length: usize, attention: Attention, device: Device) -> Tensor {
    let seen = mask(&Tensor::ones([1, int(length)], (Kind::Bool, device)), attention);
    let nothing = Tensor::zeros(seen.size().as_slice(), (Kind::Float, device));
    nothing.masked_fill(&seen.logical_not(), f64::NEG_INFINITY)
}

/// The blocks and the last norm.
pub(crate) struct Transformer {
    blocks: Vec<Block>,
    norm: nn::LayerNorm,
}

impl Transformer {
    pub(crate) fn new(path: &nn::Path<'_>, size: &Size) -> Self {
        let blocks = (0..size.layers).map(|i| Block::new(&(path / "block" / i), size)).collect();
        let norm = nn::layer_norm(path / "norm", vec![size.width], Default::default());
        Self { blocks, norm }
    }

    /// Tokens `[W, 3 L, d]` to features of the last `keep` steps `[W, keep, 3, d]`. The last block processes those
    /// alone.
    pub(super) fn forward(&self, tokens: &Tensor, mask: &Tensor, keep: usize) -> Tensor {
        let kept = int(keep) * MODALITIES;
        self.last_tokens(tokens, Some(mask), kept).unflatten(1, [-1, MODALITIES])
    }

    /// Tokens `[W, S, d]`, whose attention is `mask` `[W or 1, 1, S, S]` (`None`: all to all), to features
    /// `[W, kept, d]` of the last `kept` of them.
    pub(crate) fn last_tokens(&self, tokens: &Tensor, mask: Option<&Tensor>, kept: i64) -> Tensor {
        let all = tokens.size()[1];
        let mut x = tokens.shallow_clone();
        for (i, block) in self.blocks.iter().enumerate() {
            let last = i + 1 == self.blocks.len();
            x = block.forward(&x, mask, if last { kept } else { all });
        }
        self.norm.forward(&x)
    }
}

#[cfg(test)]
mod tests {
    use tch::Device;

    use super::*;
    use crate::batch::Windows;

    fn rows(valid: &[bool], attention: Attention) -> Vec<Vec<bool>> {
        let size = [1, int(valid.len())];
        let mask = mask(&Windows::grid(valid, &size, Device::Cpu), attention);
        assert_eq!(mask.size()[..2], [1, 1]);
        Vec::<Vec<bool>>::try_from(mask.squeeze()).unwrap()
    }

    #[test]
    fn bidirectional_sees_everything_but_padding() {
        let rows = rows(&[false, true], Attention::Bidirectional);
        for row in &rows[3..] {
            assert_eq!(row, &[false, false, false, true, true, true]);
        }
        assert!((0..6).all(|i| rows[i][i]));
    }

    #[test]
    fn a_whole_window_s_mask_gives_the_same_sums() {
        for attention in [Attention::Causal, Attention::Bidirectional] {
            let seen = mask(&Windows::grid(&[true; 3], &[1, 3], Device::Cpu), attention);
            let added = whole_mask(3, attention, Device::Cpu);
            assert_eq!(added.size(), seen.size());
            let weights = added.exp();
            assert!(weights.equal(&seen.to_kind(Kind::Float)), "what is seen counts in full, the rest not at all");
        }
    }

    #[test]
    fn a_query_sees_what_comes_before_and_is_seen_by_none() {
        // o, m, query, a of each step; the first step is padding.
        let rows = rows(&[false, true, true], Attention::Queried);
        let seen = |row: usize| rows[row].iter().map(|seen| if *seen { '1' } else { '0' }).collect::<String>();
        assert_eq!(seen(6), "000011100000");
        assert_eq!(seen(7), "000011010000");
        assert_eq!(seen(10), "000011011110");
        assert_eq!(seen(11), "000011011101");
    }

    #[test]
    fn causal_sees_itself_and_before_but_never_padding() {
        let rows = rows(&[false, true], Attention::Causal);
        assert_eq!(rows[3], [false, false, false, true, false, false]);
        assert_eq!(rows[4], [false, false, false, true, true, false]);
        assert_eq!(rows[5], [false, false, false, true, true, true]);
    }
}
