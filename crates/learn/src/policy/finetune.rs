//! The policy `finetune`: the pretrained transformer itself, trained on by weighted behaviour
//! cloning. A causal pass; the action is read from the last m token by the head of AA.
//!
//! In training some windows' past is hidden, as pretraining hides elements, so that the newest step
//! must do; acting sees all.
//!
//! −log P_θ′(a_{i+l} | τ), Gaussian with fixed variance: the squared error of the standardised action.

use std::collections::BTreeMap;

use rand_chacha::ChaCha8Rng;
use tch::{Device, Tensor};

use super::method::{About, Entry, Losses, Made, Method, Seen, Start};
use crate::batch::Chunks;
use crate::checkpoint::{self, CheckpointInfo, CheckpointKind};
use crate::error::LearnError;
use crate::model::{Attention, Network, View};
use crate::objective::{action_autoregression, squared_error};
use crate::spec::ModelSpec;

pub(super) const ENTRY: Entry = Entry { model, begin, load };

fn model(start: &Start<'_>) -> Result<ModelSpec, LearnError> {
    Ok(checkpoint::inspect(encoder(start)?)?.model)
}

fn begin(start: &Start<'_>, info: &CheckpointInfo) -> Made {
    let (stored, named) = checkpoint::read(encoder(start)?, CheckpointKind::Encoder)?;
    if stored.shape != info.shape {
        return Err(LearnError::invalid(
            "shape",
            "differs from the shape the encoder was pretrained on; use that or pretrain again",
        ));
    }
    load(info, &named, start.device)
}

fn encoder<'a>(start: &Start<'a>) -> Result<&'a [u8], LearnError> {
    start.encoder.ok_or_else(|| {
        LearnError::invalid("encoder", "is missing; finetune goes on from one, the other policies need none")
    })
}

pub(super) fn load(info: &CheckpointInfo, named: &BTreeMap<String, Tensor>, device: Device) -> Made {
    Ok(Box::new(CausalTransformer(Network::from_named(&info.shape, info.model, named, device)?)))
}

/// The transformer as a policy, wherever its first weights come from.
pub(super) struct CausalTransformer(pub(super) Network);

impl CausalTransformer {
    /// The standardised a_t of each window, `[W, 1, A]`. The last layer works on step t alone.
    fn predict(&self, seen: &Seen) -> Tensor {
        let steps = self.0.steps(&seen.embedded, &seen.proprioception, &seen.action);
        let view = View { attention: Attention::Causal, hidden: seen.hidden.as_ref() };
        let features = self.0.features(&steps, &seen.windows, view, 1);
        action_autoregression::predict(&self.0, &features)
    }
}

impl Method for CausalTransformer {
    fn about(&self) -> About<'_> {
        About {
            shape: &self.0.shape,
            statistics: &self.0.statistics,
            device: self.0.device(),
            window: self.0.spec.window(),
            chunk: 1,
            width: self.0.width(),
        }
    }

    fn parameters(&self) -> Vec<(String, Tensor)> {
        self.0.parameters()
    }

    fn encode(&self, images: &[Tensor]) -> Tensor {
        self.0.encode(images)
    }

    fn losses(&self, seen: &Seen, wanted: &Chunks, _: &mut ChaCha8Rng) -> Losses {
        let target = self.0.statistics.action.apply(&wanted.action);
        Losses { each: squared_error(&self.predict(seen), &target).squeeze_dim(1), parts: Vec::new() }
    }

    fn act(&self, seen: &Seen) -> Tensor {
        self.predict(seen)
    }
}
