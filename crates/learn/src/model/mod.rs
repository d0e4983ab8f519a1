//! The multi-modality transformer T(·) with its heads: plain layers and their shapes. Independent of losses, optimisers
//! and scores.

mod heads;
mod image_encoder;
pub(crate) mod image_weights;
mod layers;
mod perceptron;
mod size;
mod tokens;
mod transformer;
mod waves;
pub(crate) mod weights;

pub(crate) use image_encoder::{IMAGES, ImageEncoder, ImageStages, TokenGrid};
pub(crate) use perceptron::Perceptron;
pub(crate) use size::Size;
pub(crate) use tokens::Modality;
pub(crate) use transformer::{Attention, Decoder, Transformer};
pub(crate) use waves::Waves;

use std::collections::BTreeMap;

use tch::{Device, Kind, Tensor, nn};

use crate::batch::{Batch, Windows, int};
use crate::error::LearnError;
use crate::normalize::Statistics;
use crate::shape::TaskShape;
use gleaner_core::ModelSpec;
use heads::Heads;
use tokens::{MODALITIES, Tokens};
use transformer::{QUERY, mask, whole_mask};

/// The network of one task.
pub(crate) struct Network {
    pub(crate) shape: TaskShape,
    pub(crate) spec: ModelSpec,
    pub(crate) statistics: Statistics,
    pub(crate) heads: Heads,
    store: nn::VarStore,
    images: ImageEncoder,
    tokens: Tokens,
    transformer: Transformer,
    /// The masks of a window without padding.
    causal: Tensor,
    queried: Tensor,
    bidirectional: Tensor,
}

impl Network {
    /// The network with initial weights drawn from `seed`.
    pub(crate) fn new(shape: &TaskShape, spec: ModelSpec, statistics: Statistics, seed: u64, device: Device) -> Self {
        let network = Self::build(shape, spec, statistics, device);
        weights::draw(&network.parameters(), spec.keypoint_gain, seed);
        network
    }

    /// Replaces a share of each weight by the one that a network of this seed begins with, of all but a ResNet.
    pub(crate) fn freshen(&self, share: f64, seed: u64) -> Result<(), LearnError> {
        let parameters = self.parameters();
        let stored = parameters.iter().map(|(name, weights)| (name.clone(), weights.detach().copy())).collect();
        weights::draw(&parameters, self.spec.keypoint_gain, seed);
        weights::blend(&parameters, &stored, share)
    }

    /// The network with the weights in `named`.
    pub(crate) fn from_named(
        shape: &TaskShape,
        spec: ModelSpec,
        named: &BTreeMap<String, Tensor>,
        device: Device,
    ) -> Result<Self, LearnError> {
        let target = Size::of(spec.preset).target;
        let statistics = Statistics::from_named(shape, target, named, device)?;
        let network = Self::build(shape, spec, statistics, device);
        weights::load(&network.parameters(), named)?;
        Ok(network)
    }

    /// The network without weights of its own: they are still to be drawn or loaded.
    pub(crate) fn build(shape: &TaskShape, spec: ModelSpec, statistics: Statistics, device: Device) -> Self {
        let store = nn::VarStore::new(device);
        let root = store.root() / "model";
        let size = Size::of(spec.preset);
        Self {
            heads: Heads::new(&(&root / "head"), shape, &size, spec.action_token),
            images: ImageEncoder::new(&(&root / IMAGES), shape, &spec),
            tokens: Tokens::new(&(&root / "token"), shape, size.width, &spec),
            transformer: Transformer::new(&(&root / "transformer"), &size),
            causal: whole_mask(spec.window(), Attention::Causal, device),
            queried: whole_mask(spec.window(), Attention::Queried, device),
            bidirectional: whole_mask(spec.window(), Attention::Bidirectional, device),
            shape: shape.clone(),
            spec,
            statistics,
            store,
        }
    }

    /// Every parameter in name order.
    pub(crate) fn parameters(&self) -> Vec<(String, Tensor)> {
        weights::sorted(&self.store)
    }

    /// Parameters and statistics with their names in a checkpoint.
    pub(crate) fn named(&self) -> Vec<(String, Tensor)> {
        let mut named = self.parameters();
        named.extend(self.statistics.named());
        named
    }

    pub(crate) fn device(&self) -> Device {
        self.store.device()
    }

    /// Width d of tokens and features.
    pub(crate) fn width(&self) -> usize {
        usize::try_from(Size::of(self.spec.preset).width).unwrap_or(0)
    }

    /// Images, per camera `[N, C, H, W]`, to one embedding for each step `[N, d]`.
    pub(crate) fn embed_images(&self, images: &[Tensor]) -> Tensor {
        self.encode(&self.statistics.images(images))
    }

    /// Frames, each with the layout of one step of [`StepSource`](crate::StepSource), to one embedding each `[N, d]`.
    pub(crate) fn embed_frames(&self, frames: &[&[u8]]) -> Tensor {
        self.encode(&self.statistics.frames(&self.shape, frames, self.device()))
    }

    /// Standardised images, per camera `[N, C, H, W]`, to one embedding for each step `[N, d]`.
    pub(crate) fn encode(&self, images: &[Tensor]) -> Tensor {
        self.images.forward(images)
    }

    /// Embedded o `[N, d]`, m `[N, M]` and a `[N, A]` in physical units, to `[N, 3, d]`.
    pub(crate) fn steps(&self, embedded: &Tensor, m: &Tensor, a: &Tensor) -> Tensor {
        let m = self.statistics.proprioception.apply(m);
        let a = self.statistics.action.apply(a);
        self.tokens.steps(embedded, &m, &a)
    }

    /// The steps of a batch, `[N, 3, d]`; every frame is encoded once.
    pub(crate) fn batch_steps(&self, batch: &Batch) -> Tensor {
        let embedded = self.embed_images(&batch.images);
        self.steps(&embedded, &batch.seen_proprioception, &batch.action)
    }

    /// Features z of the last `keep` steps of each window, `[W, keep, 3, d]`.
    ///
    /// `steps` is `[N, 3, d]`; `hidden` `[W, L, 3]` marks the elements that are masked out, M(τ).
    pub(crate) fn features(&self, steps: &Tensor, windows: &Windows, view: View<'_>, keep: usize) -> Tensor {
        let tokens = self.tokens.windows(steps, windows, view.hidden);
        self.transformer.forward(&tokens, &self.mask(windows, view.attention, tokens.kind()), keep)
    }

    /// The standardised action after the history of each of the last `keep` steps, `[W, keep, A]`: a_t is read from the
    /// query, from the token of m_t, or from that of o_t with o_t and m_t themselves. None of them attends to a_t.
    ///
    /// `steps` and `hidden` as in [`Network::features`]; `proprioception` `[N, M]` is that of the steps, in physical
    /// units.
    pub(crate) fn actions(
        &self,
        steps: &Tensor,
        proprioception: &Tensor,
        windows: &Windows,
        hidden: Option<&Tensor>,
        keep: usize,
    ) -> Tensor {
        let Some(tokens) = self.tokens.queried(steps, windows, hidden, keep == 1) else {
            let view = View { attention: Attention::Causal, hidden };
            let features = self.features(steps, windows, view, keep);
            let of_step = self.heads.step(|| {
                let newest = windows.newest(keep);
                let of = |each: &Tensor| each.index_select(0, &newest).unflatten(0, [-1, int(keep)]);
                let m = of(&self.statistics.proprioception.apply(proprioception));
                [Modality::Image.of(&features), of(&Modality::Image.of(steps)), m]
            });
            return of_step.unwrap_or_else(|| self.heads.action(&Modality::Proprioception.of(&features)));
        };
        let features = if keep == 1 {
            // The query is where the newest a would be.
            Modality::Action.of(&self.transformer.forward(
                &tokens,
                &self.mask(windows, Attention::Causal, tokens.kind()),
                1,
            ))
        } else {
            let mask = self.mask(windows, Attention::Queried, tokens.kind());
            let kept = self.transformer.last_tokens(&tokens, Some(&mask), int(keep) * (MODALITIES + 1));
            kept.unflatten(1, [-1, MODALITIES + 1]).select(2, QUERY)
        };
        self.heads.action(&features)
    }

    /// The attention mask. Computing one costs as much as a layer of one window, so the mask of nearly every pass is
    /// precomputed.
    ///
    /// It has the kind of the tokens: of two kinds, the library's fused attention computes wrong values without an
    /// error.
    fn mask(&self, windows: &Windows, attention: Attention, kind: Kind) -> Tensor {
        if windows.length != self.spec.window() || windows.valid_places.contains(&false) {
            return mask(&windows.valid, attention);
        }
        let whole = match attention {
            Attention::Causal => &self.causal,
            Attention::Queried => &self.queried,
            Attention::Bidirectional => &self.bidirectional,
        };
        whole.to_kind(kind)
    }
}

/// Visibility within the windows of a pass.
#[derive(Clone, Copy)]
pub(crate) struct View<'a> {
    /// Attention between tokens.
    pub(crate) attention: Attention,
    /// `[W, L, 3]` of `bool`: elements replaced by the mask token.
    pub(crate) hidden: Option<&'a Tensor>,
}

impl View<'_> {
    /// No element hidden, every token attends to every other.
    pub(crate) const WHOLE: Self = View { attention: Attention::Bidirectional, hidden: None };
    /// No element hidden, a token attends to itself and those before it.
    pub(crate) const CAUSAL: Self = View { attention: Attention::Causal, hidden: None };
}

#[cfg(test)]
mod tests;
