//! What every policy can do, and the list of them. A new policy is a file with an [`Entry`] and a
//! line here; knows nothing of batches' origin or of sessions.

use std::collections::BTreeMap;

use rand_chacha::ChaCha8Rng;
use tch::{Device, Tensor};

use super::{act, bc, finetune, tf_bc};
use crate::batch::{Chunks, Windows, int};
use crate::checkpoint::CheckpointInfo;
use crate::error::LearnError;
use crate::normalize::Statistics;
use crate::spec::{ModelSpec, PolicyKind, TaskShape, TrainSpec};
use crate::train::Learner;
use crate::trajectory::Trajectory;

/// The entry of `kind`: the one list of policies.
pub(super) fn entry(kind: PolicyKind) -> Entry {
    match kind {
        PolicyKind::Finetune => finetune::ENTRY,
        PolicyKind::TfBc => tf_bc::ENTRY,
        PolicyKind::Bc => bc::ENTRY,
        PolicyKind::Act => act::ENTRY,
    }
}

/// A policy, or why there is none.
pub(super) type Made = Result<Box<dyn Method>, LearnError>;

/// How a policy comes to be.
pub(super) struct Entry {
    /// The model it will have, from cheap looks alone.
    pub(super) model: fn(&Start<'_>) -> Result<ModelSpec, LearnError>,
    /// The policy before its first step, with the model in the header.
    pub(super) begin: fn(&Start<'_>, &CheckpointInfo) -> Made,
    /// The policy with the weights of a checkpoint.
    pub(super) load: fn(&CheckpointInfo, &BTreeMap<String, Tensor>, Device) -> Made,
}

/// What a policy may begin from.
pub(super) struct Start<'a> {
    pub(super) shape: &'a TaskShape,
    /// A pretrained encoder's checkpoint.
    pub(super) encoder: Option<&'a [u8]>,
    /// Every episode it will learn from.
    pub(super) data: &'a [&'a Trajectory],
    pub(super) spec: &'a TrainSpec,
    pub(super) device: Device,
}

/// One kind of policy, π(a_t … a_{t+k−1} | history). `Send`: a session's policy lives on a thread of
/// its own.
pub(super) trait Method: Send {
    /// What it was made for.
    fn about(&self) -> About<'_>;

    /// Every parameter in name order.
    fn parameters(&self) -> Vec<(String, Tensor)>;

    /// Standardised images, per camera `[N, C, H, W]`, to one embedding a step, `[N, d]`.
    fn encode(&self, images: &[Tensor]) -> Tensor;

    /// As [`Method::encode`], of images of 0 … 1.
    fn embed_images(&self, images: &[Tensor]) -> Tensor {
        self.encode(&self.about().statistics.images(images))
    }

    /// −log P of what should be done after each window, up to constants. `rng` is for noise.
    fn losses(&self, seen: &Seen, wanted: &Chunks, rng: &mut ChaCha8Rng) -> Losses;

    /// What to do after each window: standardised, `[W, k, A]`.
    fn act(&self, seen: &Seen) -> Tensor;
}

/// What a policy was made for.
pub(super) struct About<'a> {
    pub(super) shape: &'a TaskShape,
    pub(super) statistics: &'a Statistics,
    pub(super) device: Device,
    /// Steps of history it sees, l + 1.
    pub(super) window: usize,
    /// Actions it gives at once, k.
    pub(super) chunk: usize,
    /// Values of an image embedding, d.
    pub(super) width: usize,
}

/// What a policy sees: windows over N steps whose images are embedded.
pub(super) struct Seen {
    /// `[N, d]`.
    pub(super) embedded: Tensor,
    /// `[N, M]` in physical units.
    pub(super) proprioception: Tensor,
    /// `[N, A]` in physical units; each window's last is not known when acting, so none may look.
    pub(super) action: Tensor,
    pub(super) windows: Windows,
    /// `[W, L, 3]`: which o, m and a of the windows are hidden, in training.
    pub(super) hidden: Option<Tensor>,
}

impl Seen {
    /// Of `steps` `[N, …]` the newest one of each window, `[W, …]`.
    pub(super) fn newest(&self, steps: &Tensor) -> Tensor {
        let places = self.windows.index.view([-1, int(self.windows.length)]).select(1, -1);
        steps.index_select(0, &places)
    }
}

/// The losses of W segments.
pub(super) struct Losses {
    /// `[W]`.
    pub(super) each: Tensor,
    /// What they are made of, `[W]` each, for the metrics.
    pub(super) parts: Vec<(&'static str, Tensor)>,
}

impl Learner for Box<dyn Method> {
    fn from_named(info: &CheckpointInfo, named: &BTreeMap<String, Tensor>, device: Device) -> Result<Self, LearnError> {
        (entry(info.policy.unwrap_or_default()).load)(info, named, device)
    }

    fn parameters(&self) -> Vec<(String, Tensor)> {
        self.as_ref().parameters()
    }

    fn named(&self) -> Vec<(String, Tensor)> {
        let mut named = self.as_ref().parameters();
        named.extend(self.about().statistics.named());
        named
    }
}
