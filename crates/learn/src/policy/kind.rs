//! What a policy is: how one is made, its loss on a batch, how it acts. Must not depend on which policies there are, on
//! the origin of batches, or on sessions.

use std::collections::BTreeMap;

use gleaner_core::kinds::{Kind, Needs};
use gleaner_core::{Chosen, ModelSpec, Setting, TrainSpec};
use rand_chacha::ChaCha8Rng;
use tch::{Device, Tensor};

use crate::batch::{Chunks, Windows, int};
use crate::checkpoint::CheckpointInfo;
use crate::error::LearnError;
use crate::normalize::Statistics;
use crate::shape::TaskShape;
use crate::trajectory::Trajectory;

/// A policy, or the reason why it cannot be made.
pub(super) type NewPolicy = Result<Box<dyn PolicyModel>, LearnError>;

/// One kind of policy: its description, its settings, and how one is made.
pub(super) struct PolicyKind {
    /// The word in settings, such as `tf_bc`.
    pub(super) name: &'static str,
    /// The name for people.
    pub(super) title: &'static str,
    /// What it is, in one sentence.
    pub(super) about: &'static str,
    /// What it cannot do without.
    pub(super) needs: Needs,
    /// The settings that it has besides those of every training.
    pub(super) settings: fn() -> Vec<Setting>,
    /// The size of the model that it will have.
    pub(super) model: fn(&PolicyInit<'_>) -> Result<ModelSpec, LearnError>,
    /// The policy before its first step; the header holds the model and the policy's settings.
    pub(super) init: fn(&PolicyInit<'_>, &CheckpointInfo) -> NewPolicy,
    /// The policy with the weights of a checkpoint.
    pub(super) load: fn(&CheckpointInfo, &BTreeMap<String, Tensor>, Device) -> NewPolicy,
}

impl PolicyKind {
    /// Its description as data.
    pub(super) fn describe(&self) -> Kind {
        let [name, title, about] = [self.name, self.title, self.about].map(str::to_owned);
        Kind { name, title, about, needs: self.needs, settings: (self.settings)() }
    }
}

/// What a policy is made from.
pub(super) struct PolicyInit<'a> {
    pub(super) shape: &'a TaskShape,
    /// A pretrained encoder's checkpoint.
    pub(super) encoder: Option<&'a [u8]>,
    /// Every episode of the training.
    pub(super) data: &'a [&'a Trajectory],
    pub(super) spec: &'a TrainSpec,
    pub(super) device: Device,
}

impl PolicyInit<'_> {
    /// The policy's own settings.
    pub(super) fn chosen(&self) -> &Chosen {
        &self.spec.policy
    }
}

/// One kind of policy, π(a_t … a_{t+k−1} | history). `Send`: a session's policy lives on a thread of
/// its own.
pub(super) trait PolicyModel: Send {
    /// What it was made for.
    fn info(&self) -> PolicyInfo<'_>;

    /// How often training hides a window's past, 0 … 1.
    fn history_dropout(&self) -> f64 {
        0.0
    }

    /// Every parameter in name order.
    fn parameters(&self) -> Vec<(String, Tensor)>;

    /// Standardised images, per camera `[N, C, H, W]`, to one embedding a step, `[N, d]`.
    fn encode(&self, images: &[Tensor]) -> Tensor;

    /// As [`PolicyModel::encode`], of images of 0 … 1.
    fn embed_images(&self, images: &[Tensor]) -> Tensor {
        self.encode(&self.info().statistics.images(images))
    }

    /// −log P of what should be done after each window, up to constants. `rng` is for noise.
    fn losses(&self, input: &PolicyInput, wanted: &Chunks, rng: &mut ChaCha8Rng) -> Losses;

    /// What to do after each window: standardised, `[W, k, A]`.
    fn act(&self, input: &PolicyInput) -> Tensor;
}

/// What a policy was made for.
pub(super) struct PolicyInfo<'a> {
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
pub(super) struct PolicyInput {
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

impl PolicyInput {
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
