//! What a policy from scratch starts with when it is not the transformer: a store of weights,
//! statistics of what it learns from, and the image encoder. It sees one step.

use std::collections::BTreeMap;

use gleaner_core::{ModelSpec, SizeSpec};
use tch::nn::{self, VarStore};
use tch::{Device, Tensor};

use super::kind::{PolicyInfo, PolicyInit};
use crate::checkpoint::CheckpointInfo;
use crate::error::LearnError;
use crate::model::{ImageEncoder, Size, weights};
use crate::normalize::Statistics;
use crate::shape::TaskShape;

/// The parts every such policy has; its own go into `store` under [`Scratch::root`].
pub(super) struct Scratch {
    pub(super) shape: TaskShape,
    pub(super) statistics: Statistics,
    pub(super) size: Size,
    store: VarStore,
    images: ImageEncoder,
}

/// The model of a policy that sees one step: a history of l = 0.
pub(super) fn model(from: &PolicyInit<'_>) -> Result<ModelSpec, LearnError> {
    let SizeSpec { preset } = from.chosen().read()?;
    Ok(ModelSpec { preset, segment_length: 0 })
}

impl Scratch {
    /// With statistics of the training's episodes; no weight is drawn yet.
    pub(super) fn init(from: &PolicyInit<'_>, info: &CheckpointInfo) -> Result<Self, LearnError> {
        let target = Size::of(info.model.preset).target;
        let statistics = Statistics::measure(from.shape, from.data, target, from.device);
        Ok(Self::build(info, statistics, from.device))
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
    pub(super) fn info(&self, chunk: usize) -> PolicyInfo<'_> {
        PolicyInfo {
            shape: &self.shape,
            statistics: &self.statistics,
            device: self.store.device(),
            window: 1,
            chunk,
            width: usize::try_from(self.size.width).unwrap_or(0),
        }
    }
}
