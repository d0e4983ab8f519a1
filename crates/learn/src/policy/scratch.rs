//! What a policy from scratch starts with when it is not the transformer: a store of weights,
//! statistics of what it learns from, and the image encoder. It sees one step.

use std::collections::BTreeMap;

use tch::nn::{self, VarStore};
use tch::{Device, Tensor};

use super::method::{About, Start};
use crate::checkpoint::CheckpointInfo;
use crate::error::LearnError;
use crate::model::{ImageEncoder, Size, weights};
use crate::normalize::Statistics;
use crate::spec::{ModelSpec, TaskShape};

/// The parts every such policy has; its own go into `store` under [`Scratch::root`].
pub(super) struct Scratch {
    pub(super) shape: TaskShape,
    pub(super) statistics: Statistics,
    pub(super) size: Size,
    store: VarStore,
    images: ImageEncoder,
}

/// The model of a policy that sees one step: a history of l = 0.
pub(super) fn model(start: &Start<'_>) -> Result<ModelSpec, LearnError> {
    Ok(ModelSpec { segment_length: 0, ..start.spec.model })
}

impl Scratch {
    /// For what `start` learns from; nothing is drawn yet.
    pub(super) fn begin(start: &Start<'_>, info: &CheckpointInfo) -> Self {
        let target = Size::of(info.model.preset).target;
        let statistics = Statistics::measure(start.shape, start.data, target, start.device);
        Self::build(info, statistics, start.device)
    }

    /// With the statistics in `named`; no weight is loaded yet.
    pub(super) fn load(
        info: &CheckpointInfo,
        named: &BTreeMap<String, Tensor>,
        device: Device,
    ) -> Result<Self, LearnError> {
        let target = Size::of(info.model.preset).target;
        let statistics = Statistics::from_named(&info.shape, target, named, device)?;
        Ok(Self::build(info, statistics, device))
    }

    fn build(info: &CheckpointInfo, statistics: Statistics, device: Device) -> Self {
        let (store, size) = (VarStore::new(device), Size::of(info.model.preset));
        let images = ImageEncoder::new(&(store.root() / "policy" / "image"), &info.shape, &size);
        Self { shape: info.shape.clone(), statistics, size, store, images }
    }

    /// Where a policy's own layers go.
    pub(super) fn root(&self) -> nn::Path<'_> {
        self.store.root() / "policy"
    }

    pub(super) fn parameters(&self) -> Vec<(String, Tensor)> {
        weights::sorted(&self.store)
    }

    /// Draws every weight, once all layers are there.
    pub(super) fn draw(&self, seed: u64) {
        weights::draw(&self.parameters(), seed);
    }

    /// Loads every weight, once all layers are there.
    pub(super) fn take(&self, named: &BTreeMap<String, Tensor>) -> Result<(), LearnError> {
        weights::load(&self.parameters(), named)
    }

    pub(super) fn encode(&self, images: &[Tensor]) -> Tensor {
        self.images.forward(images)
    }

    /// What a policy that gives `chunk` actions at once was made for.
    pub(super) fn about(&self, chunk: usize) -> About<'_> {
        About {
            shape: &self.shape,
            statistics: &self.statistics,
            device: self.store.device(),
            window: 1,
            chunk,
            width: usize::try_from(self.size.width).unwrap_or(0),
        }
    }
}
