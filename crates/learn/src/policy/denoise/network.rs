//! The network of policies that remove noise: a transformer over o, m and the places of a noisy chunk. Plain layers and
//! their shapes.

use tch::nn::{self, Module};
use tch::{Kind, Tensor};

use crate::model::{Transformer, Waves};
use crate::policy::observer::Observer;

/// Tokens that the chunk's places attend to: o and m.
const MEMORY: i64 = 2;
/// The shortest and the longest period of the waves that represent a time in 0 … 1.
const PERIODS: [f64; 2] = [4e-3, 4.0];

pub(super) struct Network {
    proprioception: nn::Linear,
    action: nn::Linear,
    time: [nn::Linear; 2],
    /// `[2, d]`: the embeddings that distinguish o and m.
    memory: Tensor,
    /// `[k, d]`.
    place: Tensor,
    transformer: Transformer,
    out: nn::Linear,
    waves: Waves,
    /// `[1, 1, 2 + k, 2 + k]` of `bool`, true where the query (row) may attend to the key (column): o and m to each other,
    /// places of the chunk to all.
    mask: Tensor,
}

impl Network {
    pub(super) fn new(path: &nn::Path<'_>, observer: &Observer, chunk: i64) -> Self {
        let size = &observer.size;
        let linear = |name: &str, from, to| nn::linear(path / name, from, to, Default::default());
        let (d, device) = (size.width, path.device());
        let all = MEMORY + chunk;
        let mask = Tensor::ones([all, all], (Kind::Bool, device));
        let _ = mask.narrow(0, 0, MEMORY).narrow(1, MEMORY, chunk).fill_(0);
        Self {
            proprioception: linear("proprioception", observer.proprioception(), d),
            action: linear("action", observer.action(), d),
            time: [linear("time_hidden", d, d), linear("time_out", d, d)],
            memory: path.zeros("memory_embedding", &[MEMORY, d]),
            place: path.zeros("place_embedding", &[chunk, d]),
            transformer: Transformer::new(&(path / "transformer"), size),
            out: linear("out", d, observer.action()),
            waves: Waves::new(PERIODS, d, device),
            mask: mask.unsqueeze(0).unsqueeze(0),
        }
    }

    /// Encoded o `[W, d]` and m `[W, P]` to the tokens that a chunk is predicted from, `[W, 2, d]`.
    pub(super) fn memory(&self, o: &Tensor, m: &Tensor) -> Tensor {
        Tensor::stack(&[o, &self.proprioception.forward(m)], 1) + &self.memory
    }

    /// Memory `[R, 2, d]`, noisy chunks `[R, k, A]` and their times `[R, 1, 1]` in 0 … 1 to predictions `[R, k, A]`. Only
    /// places that are `counted` `[R, k]` are attended to by others; `None`: all are.
    pub(super) fn forward(&self, memory: &Tensor, noisy: &Tensor, time: &Tensor, counted: Option<&Tensor>) -> Tensor {
        let time = self.waves.of(&time.squeeze_dim(-1));
        let time = self.time[1].forward(&self.time[0].forward(&time).silu()).unsqueeze(1);
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
