//! The policy `perceptron`, a baseline: a two-layer perceptron from proprioception alone to a_t. The comparison with it
//! shows the value of images and of the history.
//!
//! −log P(a_t | m_t), Gaussian with fixed variance: the squared error of the standardised action.

use std::collections::BTreeMap;

use gleaner_core::kinds::Needs;
use gleaner_core::schema::integer_in;
use gleaner_core::{Augmentation, Group as _, ModelSpec, OptimSpec};
use rand_chacha::ChaCha8Rng;
use tch::nn::{self, Module, VarStore};
use tch::{Device, Kind, Tensor};

use super::kind::{Losses, NewPolicy, PolicyInfo, PolicyInit, PolicyInput, PolicyKind, PolicyModel};
use crate::batch::{Chunks, int};
use crate::checkpoint::CheckpointInfo;
use crate::dropout::dropped;
use crate::model::{Size, weights};
use crate::normalize::Statistics;
use crate::objective::squared_error;
use crate::shape::TaskShape;

pub(super) const KIND: PolicyKind = PolicyKind {
    name: "perceptron",
    title: "Perceptron",
    about: "A baseline from scratch: a two-layer perceptron from proprioception alone, without images or history.",
    needs: Needs { encoder: false, history: false, images: false, all_episodes: false },
    settings: || [PerceptronSpec::schema(), Augmentation::schema()].concat(),
    optim: OptimSpec::default,
    model: |_| Ok(ModelSpec { segment_length: 0, ..ModelSpec::default() }),
    init,
    load,
};

gleaner_core::settings! {
    /// Settings of the perceptron.
    #[derive(Copy)]
    struct PerceptronSpec {
        /// Size of the hidden layer. Larger layers fit finer functions and need more data.
        hidden_size: u32 = 256, integer_in(1, 4096);
    }
}

fn init(from: &PolicyInit<'_>, info: &CheckpointInfo) -> NewPolicy {
    let statistics = from.statistics(&info.model)?;
    let policy = Perceptron::new(info, statistics, from.device)?;
    weights::draw(&policy.parameters(), 1.0, from.spec.run.seed);
    Ok(Box::new(policy))
}

fn load(info: &CheckpointInfo, named: &BTreeMap<String, Tensor>, device: Device) -> NewPolicy {
    let target = Size::of(info.model.preset).target;
    let policy = Perceptron::new(info, Statistics::from_named(&info.shape, target, named, device)?, device)?;
    weights::load(&policy.parameters(), named)?;
    Ok(Box::new(policy))
}

struct Perceptron {
    shape: TaskShape,
    statistics: Statistics,
    store: VarStore,
    hidden: nn::Linear,
    out: nn::Linear,
}

impl Perceptron {
    fn new(info: &CheckpointInfo, statistics: Statistics, device: Device) -> Result<Self, crate::LearnError> {
        let PerceptronSpec { hidden_size } = info.settings()?;
        let (store, shape) = (VarStore::new(device), info.shape.clone());
        let root = store.root() / "policy";
        let hidden = nn::linear(&root / "hidden", int(shape.proprioception), hidden_size.into(), Default::default());
        let out = nn::linear(&root / "out", hidden_size.into(), int(shape.action), Default::default());
        drop(root);
        Ok(Self { shape, statistics, store, hidden, out })
    }

    /// The standardised a_t, `[W, 1, A]`.
    fn predict(&self, input: &PolicyInput) -> Tensor {
        let m = self.statistics.proprioception.apply(&input.newest(&input.proprioception));
        self.out.forward(&dropped(self.hidden.forward(&m).gelu("none"))).unsqueeze(1)
    }
}

impl PolicyModel for Perceptron {
    fn info(&self) -> PolicyInfo<'_> {
        let (shape, statistics, device) = (&self.shape, &self.statistics, self.store.device());
        PolicyInfo { shape, statistics, device, window: 1, chunk: 1, width: 1 }
    }

    fn parameters(&self) -> Vec<(String, Tensor)> {
        weights::sorted(&self.store)
    }

    /// A single zero for each frame: no image is read.
    fn encode(&self, images: &[Tensor]) -> Tensor {
        let frames = images.first().map_or(0, |camera| camera.size()[0]);
        Tensor::zeros([frames, 1], (Kind::Float, self.store.device()))
    }

    fn losses(&self, input: &PolicyInput, wanted: &Chunks, _: &mut ChaCha8Rng) -> Losses {
        let target = self.statistics.action.apply(&wanted.action);
        Losses { each: squared_error(&self.predict(input), &target).squeeze_dim(1), parts: Vec::new() }
    }

    fn act(&self, input: &PolicyInput) -> Tensor {
        self.predict(input)
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::untrained;
    use crate::batch::values;
    use crate::policy::source::{Source, mean_loss};
    use crate::random::{Purpose, generator};
    use crate::toy;

    #[test]
    fn images_make_no_difference() {
        let one = toy::episode("one", 3, 6, true);
        let other = one.changed(|arrays| arrays.frames.fill(0));
        let policy = untrained("perceptron", &[&one]);
        let loss = |data| {
            let source = Source { segments: crate::batch::Segments::every(&[data]), data: vec![data] };
            let (batch, wanted) = source.collect(&policy.info().form(), &source.segments.all()).unwrap();
            let mut noise = generator(1, Purpose::Style, 0);
            values(&mean_loss(policy.as_ref(), batch, None, &wanted, &mut noise).1.each)
        };
        assert_eq!(loss(&one), loss(&other));
    }
}
