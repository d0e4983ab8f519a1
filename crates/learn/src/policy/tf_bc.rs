//! The policy `tf_bc`: the transformer of `finetune` and its loss, but from scratch, with statistics of its training
//! data. The comparison with it shows the value of pretraining.

use gleaner_core::kinds::Needs;
use gleaner_core::{Group as _, ImageWeightsSpec, ModelSpec, Setting};

use super::finetune::{self, CausalTransformer};
use super::kind::{NewPolicy, PolicyInit, PolicyKind};
use crate::checkpoint::CheckpointInfo;
use crate::error::LearnError;
use crate::model::Network;

pub(super) const KIND: PolicyKind = PolicyKind {
    name: "tf_bc",
    title: "TF-BC",
    about: "The transformer of finetune from scratch, without pretraining.",
    needs: Needs { encoder: false, history: true, images: true, all_episodes: false },
    settings,
    optim: finetune::optim,
    model,
    init,
    load: finetune::load,
};

fn settings() -> Vec<Setting> {
    [ModelSpec::schema(), ImageWeightsSpec::schema(), finetune::settings()].concat()
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
