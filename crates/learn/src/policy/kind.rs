//! The definition of a policy: its construction, its loss on a batch, its actions. Must not depend on the list of
//! policies, on the origin of batches, or on sessions.

use std::collections::BTreeMap;

use gleaner_core::kinds::{Kind, Needs};
use gleaner_core::{Chosen, ModelSpec, OptimSpec, Setting, TrainSpec};
use rand_chacha::ChaCha8Rng;
use tch::{Device, Tensor};

use super::hiding::HistorySpec;
use crate::batch::{Chunks, Windows};
use crate::checkpoint::CheckpointInfo;
use crate::error::LearnError;
use crate::model::{Size, image_weights};
use crate::normalize::{Sample, Statistics};
use crate::random::{Purpose, generator, normal};
use crate::shape::TaskShape;

/// A policy, or the reason why it cannot be made.
pub(super) type NewPolicy = Result<Box<dyn PolicyModel>, LearnError>;

/// One kind of policy: its description, its settings, and its constructors.
pub(super) struct PolicyKind {
    /// The word in settings, such as `tf_bc`.
    pub(super) name: &'static str,
    /// The name for people.
    pub(super) title: &'static str,
    /// Description in one sentence.
    pub(super) about: &'static str,
    /// Its requirements.
    pub(super) needs: Needs,
    /// Its settings besides those of every training.
    pub(super) settings: fn() -> Vec<Setting>,
    /// Its defaults of [`OptimSpec::of_policy`].
    pub(super) optim: fn() -> OptimSpec,
    /// The size of its model.
    pub(super) model: fn(&PolicyInit<'_>) -> Result<ModelSpec, LearnError>,
    /// The policy before its first step; the header has the model and the policy's settings.
    pub(super) init: fn(&PolicyInit<'_>, &CheckpointInfo) -> NewPolicy,
    /// The policy with the weights of a checkpoint.
    pub(super) load: fn(&CheckpointInfo, &BTreeMap<String, Tensor>, Device) -> NewPolicy,
}

impl PolicyKind {
    /// Its description as data.
    pub(super) fn describe(&self) -> Kind {
        let [name, title, about] = [self.name, self.title, self.about].map(str::to_owned);
        let settings = [(self.settings)(), (self.optim)().of_policy()].concat();
        Kind { name, title, about, needs: self.needs, settings }
    }
}

/// The pretrained files that a policy begins from, as its settings ask for them.
#[derive(Debug, Clone, Copy, Default)]
pub struct Pretrained<'a> {
    /// An encoder's checkpoint, for `finetune` and for policies with `initial_weights` encoder.
    pub encoder: Option<&'a [u8]>,
    /// The safetensors file that `image_weights` names.
    pub image_weights: Option<&'a [u8]>,
}

impl<'a> Pretrained<'a> {
    /// An encoder's checkpoint alone.
    #[must_use]
    pub fn encoder(encoder: &'a [u8]) -> Self {
        Self { encoder: Some(encoder), image_weights: None }
    }
}

/// The inputs from which a policy is made.
pub(super) struct PolicyInit<'a> {
    pub(super) shape: &'a TaskShape,
    pub(super) pretrained: Pretrained<'a>,
    /// The steps that the training learns from.
    pub(super) sample: &'a Sample<'a>,
    pub(super) spec: &'a TrainSpec,
    pub(super) device: Device,
}

impl PolicyInit<'_> {
    /// The statistics of a policy from scratch.
    pub(super) fn statistics(&self, model: &ModelSpec) -> Result<Statistics, LearnError> {
        let target = Size::of(model.preset).target;
        let measured = Statistics::measure(self.shape, self.sample, target, self.device)?;
        Ok(measured.for_image_encoder(model.image_encoder))
    }

    /// Gives the image encoders among the `parameters` of a policy from scratch, already drawn, the weights that they
    /// begin with.
    pub(super) fn give_image_weights(
        &self,
        model: &ModelSpec,
        parameters: &[(String, Tensor)],
    ) -> Result<(), LearnError> {
        image_weights::give(model.image_encoder, parameters, self.pretrained.image_weights)
    }

    /// The policy's own settings.
    pub(super) fn chosen(&self) -> &Chosen {
        &self.spec.policy
    }
}

/// One kind of policy, π(a_t … a_{t+k−1} | history). `Send`, because a session's policy runs on a separate thread.
pub(super) trait PolicyModel: Send {
    /// The task and sizes it was made for.
    fn info(&self) -> PolicyInfo<'_>;

    /// Actions executed of each chunk before the next is predicted; 0 if a chunk is predicted at every step and all
    /// predictions for a time are ensembled.
    fn horizon(&self) -> u32 {
        0
    }

    /// Values beside the parameters and statistics that a checkpoint keeps.
    fn constants(&self) -> Vec<(String, Tensor)> {
        Vec::new()
    }

    /// How training hides a window's past; never, of a policy without one.
    fn history(&self) -> HistorySpec {
        HistorySpec::SHOWN
    }

    /// Every parameter in name order.
    fn parameters(&self) -> Vec<(String, Tensor)>;

    /// Standardised images, per camera `[N, C, H, W]`, to one embedding for each step, `[N, width]`.
    fn encode(&self, images: &[Tensor]) -> Tensor;

    /// As [`PolicyModel::encode`], for images with values in 0 … 1.
    fn embed_images(&self, images: &[Tensor]) -> Tensor {
        self.encode(&self.info().statistics.images(images))
    }

    /// −log P of the target actions after each window, up to constants. `rng` is for noise.
    fn losses(&self, input: &PolicyInput, wanted: &Chunks, rng: &mut ChaCha8Rng) -> Losses;

    /// The next actions after each window: standardised, `[W, k, A]`.
    fn act(&self, input: &PolicyInput) -> Tensor;
}

/// The task and sizes of a policy.
pub(super) struct PolicyInfo<'a> {
    pub(super) shape: &'a TaskShape,
    pub(super) statistics: &'a Statistics,
    pub(super) device: Device,
    /// Steps of history in its input, l + 1.
    pub(super) window: usize,
    /// Actions predicted at once, k.
    pub(super) chunk: usize,
    /// Values of an image embedding: d, or those of all tokens of a grid, one after the other.
    pub(super) width: usize,
}

impl<'a> PolicyInfo<'a> {
    /// The form of its batches.
    pub(super) fn form(&self) -> Form<'a> {
        Form { shape: self.shape, device: self.device, window: self.window, chunk: self.chunk }
    }
}

/// The form of a policy's batches, without tensors, so that a thread of its own can assemble them.
pub(super) struct Form<'a> {
    pub(super) shape: &'a TaskShape,
    pub(super) device: Device,
    /// Steps of history, l + 1.
    pub(super) window: usize,
    /// Actions predicted at once, k.
    pub(super) chunk: usize,
}

/// The input of a policy: windows over N steps whose images are embedded.
pub(super) struct PolicyInput {
    /// `[N, width]`, see [`PolicyInfo::width`].
    pub(super) embedded: Tensor,
    /// `[N, M]` in physical units.
    pub(super) proprioception: Tensor,
    /// `[N, A]` in physical units. Each window's last action is unknown when acting and must not be read.
    pub(super) action: Tensor,
    pub(super) windows: Windows,
    /// `[W, L, 3]`: the o, m and a of the windows that are hidden, in training.
    pub(super) hidden: Option<Tensor>,
    /// Per window, the seed and the number of its draw, for a policy that draws its actions; empty in training.
    pub(super) draws: Vec<(u64, u64)>,
    /// Windows of the whole batch before these; the random numbers of training are drawn for all of it.
    pub(super) before: usize,
}

impl PolicyInput {
    /// The newest step of each window, `[W, …]`, of `steps` `[N, …]`.
    pub(super) fn newest(&self, steps: &Tensor) -> Tensor {
        steps.index_select(0, &self.windows.newest(1))
    }

    /// N(0, 1) of `size` for each window, `[W, …size]`. A window's numbers do not depend on the other windows.
    pub(super) fn noise(&self, size: [i64; 2]) -> Tensor {
        let count = usize::try_from(size.iter().product::<i64>()).unwrap_or(0);
        let of = |(seed, number): &(u64, u64)| normal(&mut generator(*seed, Purpose::Action, *number), count);
        let drawn: Vec<f32> = self.draws.iter().flat_map(of).collect();
        let [chunk, action] = size;
        Tensor::from_slice(&drawn).view([-1, chunk, action]).to_device(self.embedded.device())
    }
}

/// The losses of W segments.
pub(super) struct Losses {
    /// `[W]`.
    pub(super) each: Tensor,
    /// Their terms, `[W]` each, for the metrics.
    pub(super) parts: Vec<(&'static str, Tensor)>,
}
