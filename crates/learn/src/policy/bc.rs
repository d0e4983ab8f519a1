//! The policy `bc`: plain behaviour cloning without history. One step's images and proprioception
//! go through a small perceptron to a_t.
//!
//! −log P(a_t | o_t, m_t), Gaussian with fixed variance: the squared error of the standardised action.

use std::collections::BTreeMap;

use rand_chacha::ChaCha8Rng;
use tch::nn::{self, Module};
use tch::{Device, Tensor};

use super::method::{About, Entry, Losses, Made, Method, Seen, Start};
use super::scratch::{self, Scratch};
use crate::batch::{Chunks, int};
use crate::checkpoint::CheckpointInfo;
use crate::objective::squared_error;

pub(super) const ENTRY: Entry = Entry { model: scratch::model, begin, load };

/// Width of the hidden layers in widths of the image embedding.
const HIDDEN: i64 = 4;

fn begin(start: &Start<'_>, info: &CheckpointInfo) -> Made {
    let policy = Bc::new(Scratch::begin(start, info));
    policy.scratch.draw(start.spec.seed);
    Ok(Box::new(policy))
}

fn load(info: &CheckpointInfo, named: &BTreeMap<String, Tensor>, device: Device) -> Made {
    let policy = Bc::new(Scratch::load(info, named, device)?);
    policy.scratch.take(named)?;
    Ok(Box::new(policy))
}

struct Bc {
    scratch: Scratch,
    hidden: [nn::Linear; 2],
    out: nn::Linear,
}

impl Bc {
    fn new(scratch: Scratch) -> Self {
        let (inputs, wide) = (scratch.size.width + int(scratch.shape.proprioception), HIDDEN * scratch.size.width);
        let linear = |name: &str, from, to| nn::linear(scratch.root() / name, from, to, Default::default());
        let hidden = [linear("hidden_0", inputs, wide), linear("hidden_1", wide, wide)];
        let out = linear("out", wide, int(scratch.shape.action));
        Self { hidden, out, scratch }
    }

    /// The standardised a_t, `[W, 1, A]`.
    fn predict(&self, seen: &Seen) -> Tensor {
        let m = self.scratch.statistics.proprioception.apply(&seen.newest(&seen.proprioception));
        let mut x = Tensor::cat(&[seen.newest(&seen.embedded), m], 1);
        for hidden in &self.hidden {
            x = hidden.forward(&x).gelu("none");
        }
        self.out.forward(&x).unsqueeze(1)
    }
}

impl Method for Bc {
    fn about(&self) -> About<'_> {
        self.scratch.about(1)
    }

    fn parameters(&self) -> Vec<(String, Tensor)> {
        self.scratch.parameters()
    }

    fn encode(&self, images: &[Tensor]) -> Tensor {
        self.scratch.encode(images)
    }

    fn losses(&self, seen: &Seen, wanted: &Chunks, _: &mut ChaCha8Rng) -> Losses {
        let target = self.scratch.statistics.action.apply(&wanted.action);
        Losses { each: squared_error(&self.predict(seen), &target).squeeze_dim(1), parts: Vec::new() }
    }

    fn act(&self, seen: &Seen) -> Tensor {
        self.predict(seen)
    }
}
