//! The policy `bc`: plain behaviour cloning without history. One step's images and proprioception
//! go through a small perceptron to a_t.
//!
//! −log P(a_t | o_t, m_t), Gaussian with fixed variance: the squared error of the standardised action.

use std::collections::BTreeMap;

use gleaner_core::ModelSpec;
use gleaner_core::kinds::Needs;
use rand_chacha::ChaCha8Rng;
use tch::nn::{self, Module};
use tch::{Device, Tensor};

use super::kind::{Losses, NewPolicy, PolicyInfo, PolicyInit, PolicyInput, PolicyKind, PolicyModel};
use super::scratch::{self, Scratch};
use crate::batch::{Chunks, int};
use crate::checkpoint::CheckpointInfo;
use crate::objective::squared_error;

pub(super) const KIND: PolicyKind = PolicyKind {
    name: "bc",
    title: "BC",
    about: "Behaviour cloning from scratch without history: one step's images and proprioception to its action.",
    needs: Needs { encoder: false, history: false, images: true, all_episodes: false },
    settings: ModelSpec::schema_of_one_step,
    model: scratch::model,
    init,
    load,
};

/// Width of the hidden layers, in multiples of the image embedding's width.
const HIDDEN: i64 = 4;

fn init(from: &PolicyInit<'_>, info: &CheckpointInfo) -> NewPolicy {
    let policy = Bc::new(Scratch::init(from, info)?);
    policy.scratch.draw(info, from.spec.run.seed);
    Ok(Box::new(policy))
}

fn load(info: &CheckpointInfo, named: &BTreeMap<String, Tensor>, device: Device) -> NewPolicy {
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
    fn predict(&self, input: &PolicyInput) -> Tensor {
        let m = self.scratch.statistics.proprioception.apply(&input.newest(&input.proprioception));
        let mut x = Tensor::cat(&[input.newest(&input.embedded), m], 1);
        for hidden in &self.hidden {
            x = hidden.forward(&x).gelu("none");
        }
        self.out.forward(&x).unsqueeze(1)
    }
}

impl PolicyModel for Bc {
    fn info(&self) -> PolicyInfo<'_> {
        self.scratch.info(1)
    }

    fn parameters(&self) -> Vec<(String, Tensor)> {
        self.scratch.parameters()
    }

    fn encode(&self, images: &[Tensor]) -> Tensor {
        self.scratch.encode(images)
    }

    fn losses(&self, input: &PolicyInput, wanted: &Chunks, _: &mut ChaCha8Rng) -> Losses {
        let target = self.scratch.statistics.action.apply(&wanted.action);
        Losses { each: squared_error(&self.predict(input), &target).squeeze_dim(1), parts: Vec::new() }
    }

    fn act(&self, input: &PolicyInput) -> Tensor {
        self.predict(input)
    }
}
