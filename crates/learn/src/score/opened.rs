//! A pretrained encoder as a score run uses it. Must not depend on scorers.

use gleaner_core::{PretrainSpec, ScoreSpec};

use super::FeatureScale;
use super::features::Encoder;
use crate::checkpoint::{self, CheckpointKind};
use crate::device;
use crate::error::LearnError;
use crate::model::{Network, View};
use crate::normalize::FeatureScale as Scale;
use crate::objective::features_view;

/// A decoded pretrained encoder.
pub(super) struct Opened {
    pub(super) network: Network,
    scale: Option<Scale>,
    view: View<'static>,
}

impl Opened {
    /// Decodes it for a score run; with its scale only where the scorer scales features.
    pub(super) fn read(encoder: &[u8], spec: &ScoreSpec, scale: Option<FeatureScale>) -> Result<Self, LearnError> {
        let device = device::open(spec.device, spec.threads)?;
        let (info, named) = checkpoint::read(encoder, CheckpointKind::Encoder)?;
        let network = Network::from_named(&info.shape, info.model, &named, device)?;
        let scale = match scale {
            Some(FeatureScale::Whitened) => Some(Scale::from_named(&named, network.width(), device)?),
            Some(FeatureScale::Plain) | None => None,
        };
        let made = serde_json::from_str::<PretrainSpec>(&info.spec);
        let made = made.map_err(|error| LearnError::Checkpoint(format!("its settings: {error}")))?;
        Ok(Self { network, scale, view: features_view(&made.objectives) })
    }

    pub(super) fn encoder(&self) -> Encoder<'_> {
        Encoder { network: &self.network, scale: self.scale.as_ref(), view: self.view }
    }
}
