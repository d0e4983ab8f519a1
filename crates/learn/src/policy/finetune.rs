//! The policy `finetune`: the pretrained transformer, trained further by weighted behaviour cloning. The pass and the head
//! of AA, read at the newest step.
//!
//! In training the past of some windows is hidden, as pretraining hides elements, so that the newest step has to
//! suffice; acting uses all steps.
//!
//! −log P_θ′(a_{i+l} | τ), Gaussian with fixed variance: the squared error of the standardised action.

use std::collections::BTreeMap;

use gleaner_core::kinds::Needs;
use gleaner_core::schema::number_in;
use gleaner_core::{Group as _, ModelSpec, OptimSpec, Setting};
use rand_chacha::ChaCha8Rng;
use tch::{Device, Tensor};

use super::hiding::HistorySpec;
use super::kind::{Losses, NewPolicy, PolicyInfo, PolicyInit, PolicyInput, PolicyKind, PolicyModel};
use super::looking;
use crate::batch::Chunks;
use crate::checkpoint::{self, CheckpointInfo, CheckpointKind};
use crate::error::LearnError;
use crate::model::Network;
use crate::objective::squared_error;

pub(super) const KIND: PolicyKind = PolicyKind {
    name: "finetune",
    title: "SSDF",
    about: "The pretrained transformer, finetuned: a causal pass that predicts the newest action.",
    needs: Needs { encoder: true, history: true, images: true, all_episodes: false },
    settings: settings_of_pretrained,
    optim,
    model,
    init,
    load,
};

gleaner_core::settings! {
    /// Settings of a policy that begins with the weights of an encoder.
    #[derive(Copy)]
    pub(super) struct FreshSpec {
        /// Share f of fresh weights in those that a policy begins with from an encoder, the random ones that the encoder
        /// itself began with: w = (1 − f) w_pretrained + f w_first (0: as they were pretrained; 1: none of them). A larger
        /// share forgets more of the pretraining; with a smaller one a training stays closer to it.
        pub(super) fresh_share: f64 = 0.0, number_in(0.0, 1.0);
    }
}

/// With these defaults a transformer looks; without them it continues its past and copies exact positions
/// (docs/decisions/0060-a-transformer-from-scratch-looks.md, 0069-a-pretrained-transformer-looks.md).
pub(super) fn settings() -> Vec<Setting> {
    let history = HistorySpec { history_dropout: 0.9, ..HistorySpec::default() };
    [history.as_defaults(), looking::augmentation().as_defaults()].concat()
}

/// Those of the same transformer that begins with an encoder. Half of each weight is fresh: the encoder's as they are
/// cost success in picking (docs/decisions/0071-half-of-a-finetuned-weight-is-fresh.md).
fn settings_of_pretrained() -> Vec<Setting> {
    [settings(), FreshSpec { fresh_share: 0.5 }.as_defaults()].concat()
}

/// Steps drawn one by one and a higher rate: with the rate of other policies a short training ends before the transformer
/// fits the experts (docs/decisions/0062-a-transformer-learns-at-a-higher-rate.md).
pub(super) fn optim() -> OptimSpec {
    OptimSpec { stretch: 1, learning_rate: 2e-3, ..OptimSpec::default() }
}

fn model(from: &PolicyInit<'_>) -> Result<ModelSpec, LearnError> {
    Ok(checkpoint::inspect(encoder(from)?)?.model)
}

fn init(from: &PolicyInit<'_>, info: &CheckpointInfo) -> NewPolicy {
    Ok(Box::new(CausalTransformer { network: pretrained(from)?, history: info.settings()? }))
}

/// The encoder's network, with a share f of the weights that it began with: w = (1 − f) w_pretrained + f w_first. It holds
/// the actions that never change in the training's steps.
pub(super) fn pretrained(from: &PolicyInit<'_>) -> Result<Network, LearnError> {
    let (stored, named) = checkpoint::read(encoder(from)?, CheckpointKind::Encoder)?;
    if stored.shape != *from.shape {
        return Err(LearnError::invalid(
            "shape",
            "differs from the shape the encoder was pretrained on; use that or pretrain again",
        ));
    }
    let mut network = Network::from_named(from.shape, stored.model, &named, from.device)?;
    let FreshSpec { fresh_share } = from.chosen().read()?;
    if fresh_share > 0.0 {
        network.freshen(fresh_share, stored.seed()?)?;
    }
    network.statistics = network.statistics.holding(from.shape, from.sample)?;
    Ok(network)
}

/// The checkpoint that a policy begins from.
pub(super) fn encoder<'a>(from: &PolicyInit<'a>) -> Result<&'a [u8], LearnError> {
    from.pretrained.encoder.ok_or_else(|| {
        LearnError::invalid(
            "encoder",
            "is missing; finetune and initial_weights encoder start from an encoder, other policies do not need one",
        )
    })
}

pub(super) fn load(info: &CheckpointInfo, named: &BTreeMap<String, Tensor>, device: Device) -> NewPolicy {
    let network = Network::from_named(&info.shape, info.model, named, device)?;
    Ok(Box::new(CausalTransformer { network, history: info.settings()? }))
}

/// The transformer as a policy, independent of the source of its initial weights.
pub(super) struct CausalTransformer {
    pub(super) network: Network,
    pub(super) history: HistorySpec,
}

impl CausalTransformer {
    /// The standardised a_t of each window, `[W, 1, A]`. The last layer processes step t alone.
    fn predict(&self, input: &PolicyInput) -> Tensor {
        let steps = self.network.steps(&input.embedded, &input.proprioception, &input.action);
        self.network.actions(&steps, &input.proprioception, &input.windows, input.hidden.as_ref(), 1)
    }
}

impl PolicyModel for CausalTransformer {
    fn info(&self) -> PolicyInfo<'_> {
        PolicyInfo {
            shape: &self.network.shape,
            statistics: &self.network.statistics,
            device: self.network.device(),
            window: self.network.spec.window(),
            chunk: 1,
            width: self.network.width(),
        }
    }

    fn history(&self) -> HistorySpec {
        self.history
    }

    fn parameters(&self) -> Vec<(String, Tensor)> {
        self.network.parameters()
    }

    fn encode(&self, images: &[Tensor]) -> Tensor {
        self.network.encode(images)
    }

    fn losses(&self, input: &PolicyInput, wanted: &Chunks, _: &mut ChaCha8Rng) -> Losses {
        let target = self.network.statistics.action.apply(&wanted.action);
        Losses { each: squared_error(&self.predict(input), &target).squeeze_dim(1), parts: Vec::new() }
    }

    fn act(&self, input: &PolicyInput) -> Tensor {
        self.predict(input)
    }
}
