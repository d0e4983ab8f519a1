//! The policy `bc`: plain behaviour cloning. The encoded input, by default one step's images and proprioception, goes through a
//! small perceptron to a_t.
//!
//! −log P(a_t | o_t, m_t), Gaussian with fixed variance: the squared error of the standardised action.

use std::collections::BTreeMap;

use gleaner_core::OptimSpec;
use gleaner_core::kinds::Needs;
use rand_chacha::ChaCha8Rng;
use tch::{Device, Tensor};

use super::hiding::HistorySpec;
use super::kind::{Losses, NewPolicy, PolicyInfo, PolicyInit, PolicyInput, PolicyKind, PolicyModel};
use super::observer::{self, Encoded, Observer};
use crate::batch::Chunks;
use crate::checkpoint::CheckpointInfo;
use crate::model::Perceptron;
use crate::objective::squared_error;

pub(super) const KIND: PolicyKind = PolicyKind {
    name: "bc",
    title: "BC",
    about: "Behaviour cloning by a perceptron: by default from scratch, one step's images and proprioception to its action.",
    needs: Needs { encoder: false, history: false, images: true, all_episodes: false },
    settings: observer::schema,
    optim: OptimSpec::default,
    model: observer::model,
    init,
    load,
};

fn init(from: &PolicyInit<'_>, info: &CheckpointInfo) -> NewPolicy {
    let policy = Bc::new(Observer::init(from, info)?);
    policy.observer.draw(from, info)?;
    Ok(Box::new(policy))
}

fn load(info: &CheckpointInfo, named: &BTreeMap<String, Tensor>, device: Device) -> NewPolicy {
    let policy = Bc::new(Observer::load(info, named, device)?);
    policy.observer.take(named)?;
    Ok(Box::new(policy))
}

struct Bc {
    observer: Observer,
    perceptron: Perceptron,
}

impl Bc {
    fn new(observer: Observer) -> Self {
        let (inputs, wide) = (observer.size.width + observer.proprioception(), Perceptron::WIDE * observer.size.width);
        let perceptron = Perceptron::new(&observer.root(), inputs, wide, observer.action());
        Self { perceptron, observer }
    }

    /// The standardised a_t, `[W, 1, A]`.
    fn predict(&self, input: &PolicyInput) -> Tensor {
        let Encoded { images, proprioception } = self.observer.encoded(input);
        self.perceptron.forward(&Tensor::cat(&[images, proprioception], 1)).unsqueeze(1)
    }
}

impl PolicyModel for Bc {
    fn info(&self) -> PolicyInfo<'_> {
        self.observer.info(1)
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

    fn losses(&self, input: &PolicyInput, wanted: &Chunks, _: &mut ChaCha8Rng) -> Losses {
        let target = self.observer.statistics().action.apply(&wanted.action);
        Losses { each: squared_error(&self.predict(input), &target).squeeze_dim(1), parts: Vec::new() }
    }

    fn act(&self, input: &PolicyInput) -> Tensor {
        self.predict(input)
    }
}
