//! The policy `tf_bc`: the transformer of `finetune` and its loss, but from scratch, its statistics
//! measured on what it learns from. What pretraining is worth shows against it.

use super::finetune::{self, CausalTransformer};
use super::method::{Entry, Made, Start};
use crate::checkpoint::CheckpointInfo;
use crate::error::LearnError;
use crate::model::{Network, Size};
use crate::normalize::Statistics;
use crate::spec::ModelSpec;

pub(super) const ENTRY: Entry = Entry { model, begin, load: finetune::load };

fn model(start: &Start<'_>) -> Result<ModelSpec, LearnError> {
    Ok(start.spec.model)
}

fn begin(start: &Start<'_>, info: &CheckpointInfo) -> Made {
    let target = Size::of(info.model.preset).target;
    let statistics = Statistics::measure(start.shape, start.data, target, start.device);
    let network = Network::new(start.shape, info.model, statistics, start.spec.seed, start.device);
    Ok(Box::new(CausalTransformer(network)))
}
