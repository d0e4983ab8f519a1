//! The policy `tf_bc`: the transformer of `finetune` and its loss, but from scratch, with statistics of its training
//! data. The comparison with it shows the value of pretraining.

use gleaner_core::kinds::Needs;
use gleaner_core::{ActionToken, Group as _, ImageWeightsSpec, ModelSpec, OptimSpec, Setting};

use super::finetune::{self, CausalTransformer};
use super::hiding::HistorySpec;
use super::kind::{NewPolicy, PolicyInit, PolicyKind};
use super::observer;
use crate::checkpoint::CheckpointInfo;
use crate::error::LearnError;
use crate::model::Network;

pub(super) const KIND: PolicyKind = PolicyKind {
    name: "tf_bc",
    title: "TF-BC",
    about: "The transformer of finetune from scratch, without pretraining.",
    needs: Needs { encoder: false, history: true, images: true, all_episodes: false },
    settings,
    optim,
    model,
    init,
    load: finetune::load,
};

/// Without these defaults a transformer from scratch does not look: it continues its past and copies exact positions
/// (docs/decisions/0060-a-transformer-from-scratch-looks.md).
fn settings() -> Vec<Setting> {
    let model = ModelSpec { action_token: ActionToken::Image, ..ModelSpec::default() };
    let history = HistorySpec { history_dropout: 0.9, ..HistorySpec::default() };
    let inputs = observer::augmentation().as_defaults();
    [model.as_defaults(), ImageWeightsSpec::schema(), history.as_defaults(), inputs].concat()
}

/// Steps drawn one by one and a higher rate: with the rate of other policies a short training ends before the transformer
/// fits the experts (docs/decisions/0062-a-transformer-learns-at-a-higher-rate.md).
fn optim() -> OptimSpec {
    OptimSpec { stretch: 1, learning_rate: 2e-3, ..OptimSpec::default() }
}

fn model(from: &PolicyInit<'_>) -> Result<ModelSpec, LearnError> {
    Ok(from.chosen().read()?)
}

fn init(from: &PolicyInit<'_>, info: &CheckpointInfo) -> NewPolicy {
    let statistics = from.statistics(&info.model)?;
    let network = Network::new(from.shape, info.model, statistics, from.spec.run.seed, from.device);
    from.give_image_weights(&info.model, &network.parameters())?;
    Ok(Box::new(CausalTransformer { network, history: from.chosen().read()? }))
}
