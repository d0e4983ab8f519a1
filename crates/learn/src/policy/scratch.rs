//! The start of policies that are trained from scratch and are not the transformer: a store of weights, statistics of
//! the training data, and the image encoder. The input is one step.

use std::collections::BTreeMap;

use gleaner_core::ModelSpec;
use tch::nn::{self, VarStore};
use tch::{Device, Tensor};

use super::kind::{PolicyInfo, PolicyInit};
use crate::checkpoint::CheckpointInfo;
use crate::error::LearnError;
use crate::model::{IMAGES, ImageEncoder, Size, weights};
use crate::normalize::Statistics;
use crate::shape::TaskShape;

/// The parts of every such policy; its own layers are in `store` under [`Scratch::root`].
pub(super) struct Scratch {
    pub(super) shape: TaskShape,
    pub(super) statistics: Statistics,
    pub(super) size: Size,
    store: VarStore,
    images: ImageEncoder,
}

/// The model of a policy whose input is one step: a history of l = 0.
pub(super) fn model(from: &PolicyInit<'_>) -> Result<ModelSpec, LearnError> {
    Ok(ModelSpec { segment_length: 0, ..from.chosen().read()? })
}

impl Scratch {
    /// A start with statistics of the training's episodes; no weight is drawn yet.
    pub(super) fn init(from: &PolicyInit<'_>, info: &CheckpointInfo) -> Result<Self, LearnError> {
        let statistics = from.statistics(Size::of(info.model.preset).target);
        Ok(Self::build(info, statistics, from.device))
    }

    /// A start with the statistics in `named`; no weight is loaded yet.
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
        let images = ImageEncoder::new(&(store.root() / "policy" / IMAGES), &info.shape, &size);
        Self { shape: info.shape.clone(), statistics, size, store, images }
    }

    /// The path of a policy's own layers.
    pub(super) fn root(&self) -> nn::Path<'_> {
        self.store.root() / "policy"
    }

    pub(super) fn parameters(&self) -> Vec<(String, Tensor)> {
        weights::sorted(&self.store)
    }

    /// Draws every weight, after all layers are added.
    pub(super) fn draw(&self, info: &CheckpointInfo, seed: u64) {
        weights::draw(&self.parameters(), info.model.keypoint_gain, seed);
    }

    /// Loads every weight, after all layers are added.
    pub(super) fn take(&self, named: &BTreeMap<String, Tensor>) -> Result<(), LearnError> {
        weights::load(&self.parameters(), named)
    }

    pub(super) fn encode(&self, images: &[Tensor]) -> Tensor {
        self.images.forward(images)
    }

    /// The description of a policy that predicts `chunk` actions at once.
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
