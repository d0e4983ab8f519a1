//! The input side of a policy: the newest step through an image encoder, or a history through the causal transformer; with
//! random weights or those of a pretrained encoder. Its output is one vector for the images and one for proprioception in
//! each case, so that every policy has all of them; a policy that asks for a grid gets a vector of each place of the
//! newest images instead. Independent of what a policy predicts from them.

mod images;

pub(super) use images::{ImageTokens, ImagesSpec};

use std::collections::BTreeMap;

use gleaner_core::{Group as _, ImageWeightsSpec, InitialWeights, ModelSpec, ObserverSpec, Setting};
use tch::nn::{self, VarStore};
use tch::{Device, Tensor};

use super::finetune::{self, FreshSpec};
use super::hiding::HistorySpec;
use super::kind::{PolicyInfo, PolicyInit, PolicyInput};
use super::looking;
use crate::batch::int;
use crate::checkpoint::{self, CheckpointInfo};
use crate::error::LearnError;
use crate::model::{IMAGES, Modality, Network, Size, View, weights};
use crate::normalize::Statistics;
use crate::shape::TaskShape;
use images::Images;

/// The parts of every such policy; its own layers are in a store of their own under [`Observer::root`].
pub(super) struct Observer {
    pub(super) size: Size,
    shape: TaskShape,
    store: VarStore,
    backbone: Backbone,
    history: HistorySpec,
}

/// The network that encodes observations.
enum Backbone {
    /// The newest step: its images through an encoder, its proprioception as it is.
    Newest { images: Images, statistics: Statistics },
    /// The newest step's features after a causal pass over the window.
    Window(Box<Network>),
}

/// The encoded newest step of each window.
pub(super) struct Encoded {
    /// `[W, d]`; of a grid, its tokens one after the other, `[W, T d]`.
    pub(super) images: Tensor,
    /// `[W, P]`, see [`Observer::proprioception`].
    pub(super) proprioception: Tensor,
}

/// The settings of every such policy.
pub(super) fn schema() -> Vec<Setting> {
    let observer = [ObserverSpec::schema(), FreshSpec::schema(), HistorySpec::schema()].concat();
    let inputs = looking::augmentation().as_defaults();
    [ModelSpec::schema_of_one_step(), ImageWeightsSpec::schema(), observer, inputs].concat()
}

/// The size of the model; its history is that which the policy sees.
pub(super) fn model(from: &PolicyInit<'_>) -> Result<ModelSpec, LearnError> {
    let ObserverSpec { initial_weights, history_steps } = from.chosen().read()?;
    let ImagesSpec { image_tokens } = from.chosen().read()?;
    if image_tokens == ImageTokens::Grid && history_steps != 0 {
        let message = format!(
            "is grid, which shows the newest step alone, but history_steps is {history_steps}; use 0, or embedding"
        );
        return Err(LearnError::invalid("image_tokens", message));
    }
    let FreshSpec { fresh_share } = from.chosen().read()?;
    if fresh_share > 0.0 && initial_weights == InitialWeights::Random {
        let message = format!("is {fresh_share}, but initial_weights is random: all weights are; use 0, or encoder");
        return Err(LearnError::invalid("fresh_share", message));
    }
    let model = match initial_weights {
        InitialWeights::Random => ModelSpec { segment_length: history_steps, ..from.chosen().read()? },
        InitialWeights::Encoder => checkpoint::inspect(finetune::encoder(from)?)?.model,
    };
    let given: ModelSpec = from.chosen().read()?;
    for (name, differs) in [
        ("preset", given.preset != ModelSpec::default().preset && given.preset != model.preset),
        (
            "image_encoder",
            given.image_encoder != ModelSpec::default().image_encoder && given.image_encoder != model.image_encoder,
        ),
    ] {
        if differs {
            return Err(LearnError::invalid(
                name,
                "is not the encoder's, whose weights the policy begins with; leave it out",
            ));
        }
    }
    if history_steps != 0 && history_steps != model.segment_length {
        let message = format!(
            "is {history_steps}, the encoder was pretrained with a segment_length of {0}; use 0 or {0}",
            model.segment_length
        );
        return Err(LearnError::invalid("history_steps", message));
    }
    Ok(ModelSpec { segment_length: history_steps, ..model })
}

impl Observer {
    /// An observer with statistics of the training's steps, or those of an encoder. Random weights are drawn by
    /// [`Observer::draw`], after the policy's own layers are there.
    pub(super) fn init(from: &PolicyInit<'_>, info: &CheckpointInfo) -> Result<Self, LearnError> {
        let ObserverSpec { initial_weights, .. } = from.chosen().read()?;
        let statistics = match initial_weights {
            InitialWeights::Random => from.statistics(&info.model)?,
            InitialWeights::Encoder => finetune::pretrained(from)?.statistics,
        };
        Self::build(info, statistics, from.device)
    }

    /// An observer with the statistics in `named`; [`Observer::take`] loads the weights.
    pub(super) fn load(
        info: &CheckpointInfo,
        named: &BTreeMap<String, Tensor>,
        device: Device,
    ) -> Result<Self, LearnError> {
        let target = Size::of(info.model.preset).target;
        let statistics = Statistics::from_named(&info.shape, target, named, device)?;
        Self::build(info, statistics, device)
    }

    fn build(info: &CheckpointInfo, statistics: Statistics, device: Device) -> Result<Self, LearnError> {
        let (store, size) = (VarStore::new(device), Size::of(info.model.preset));
        let backbone = if info.model.segment_length == 0 {
            let ImagesSpec { image_tokens } = info.settings()?;
            let images = Images::new(&(store.root() / "policy"), &info.shape, &info.model, image_tokens);
            Backbone::Newest { images, statistics }
        } else {
            Backbone::Window(Box::new(Network::build(&info.shape, info.model, statistics, device)))
        };
        Ok(Self { shape: info.shape.clone(), size, store, backbone, history: info.settings()? })
    }

    /// The path of a policy's own layers.
    pub(super) fn root(&self) -> nn::Path<'_> {
        self.store.root() / "policy"
    }

    pub(super) fn parameters(&self) -> Vec<(String, Tensor)> {
        let mut parameters = match &self.backbone {
            Backbone::Newest { .. } => Vec::new(),
            Backbone::Window(network) => network.parameters(),
        };
        parameters.extend(weights::sorted(&self.store));
        parameters
    }

    /// Draws every weight, after all layers are added, and takes those of the encoder, or of its images' encoder, if
    /// the policy begins from one.
    pub(super) fn draw(&self, from: &PolicyInit<'_>, info: &CheckpointInfo) -> Result<(), LearnError> {
        weights::draw(&self.parameters(), info.model.keypoint_gain, from.spec.run.seed);
        let ObserverSpec { initial_weights, .. } = from.chosen().read()?;
        if initial_weights == InitialWeights::Random {
            return from.give_image_weights(&info.model, &self.parameters());
        }
        let named = finetune::pretrained(from)?.named().into_iter().collect();
        match &self.backbone {
            Backbone::Window(network) => weights::load(&network.parameters(), &named),
            Backbone::Newest { .. } => {
                // The same parameters, named after the part that they belong to.
                let own = self.parameters().into_iter().filter_map(|(name, parameter)| {
                    let image = name.strip_prefix("policy.")?;
                    image.starts_with(IMAGES).then(|| (format!("model.{image}"), parameter))
                });
                weights::load(&own.collect::<Vec<_>>(), &named)
            }
        }
    }

    /// Loads every weight, after all layers are added.
    pub(super) fn take(&self, named: &BTreeMap<String, Tensor>) -> Result<(), LearnError> {
        weights::load(&self.parameters(), named)
    }

    pub(super) fn encode(&self, images: &[Tensor]) -> Tensor {
        match &self.backbone {
            Backbone::Newest { images: encoder, .. } => encoder.forward(images),
            Backbone::Window(network) => network.encode(images),
        }
    }

    /// The newest step, encoded; the newest action is hidden.
    pub(super) fn encoded(&self, input: &PolicyInput) -> Encoded {
        match &self.backbone {
            Backbone::Newest { statistics, .. } => Encoded {
                images: input.newest(&input.embedded),
                proprioception: statistics.proprioception.apply(&input.newest(&input.proprioception)),
            },
            Backbone::Window(network) => {
                let steps = network.steps(&input.embedded, &input.proprioception, &input.action);
                let view = View { hidden: input.hidden.as_ref(), ..View::CAUSAL };
                let features = network.features(&steps, &input.windows, view, 1).select(1, 0);
                Encoded {
                    images: Modality::Image.of(&features),
                    proprioception: Modality::Proprioception.of(&features),
                }
            }
        }
    }

    pub(super) fn statistics(&self) -> &Statistics {
        match &self.backbone {
            Backbone::Newest { statistics, .. } => statistics,
            Backbone::Window(network) => &network.statistics,
        }
    }

    /// Values of encoded proprioception: M, or the width d of a feature.
    pub(super) fn proprioception(&self) -> i64 {
        match &self.backbone {
            Backbone::Newest { .. } => int(self.shape.proprioception),
            Backbone::Window(_) => self.size.width,
        }
    }

    /// Tokens of a step's images, T.
    fn image_tokens(&self) -> i64 {
        match &self.backbone {
            Backbone::Newest { images, .. } => images.tokens(),
            Backbone::Window(_) => 1,
        }
    }

    /// Values of an action, A.
    pub(super) fn action(&self) -> i64 {
        int(self.shape.action)
    }

    /// How training hides a window's past.
    pub(super) fn history(&self) -> HistorySpec {
        match &self.backbone {
            Backbone::Newest { .. } => HistorySpec::SHOWN,
            Backbone::Window(_) => self.history,
        }
    }

    /// The description of a policy that predicts `chunk` actions at once.
    pub(super) fn info(&self, chunk: usize) -> PolicyInfo<'_> {
        PolicyInfo {
            shape: &self.shape,
            statistics: self.statistics(),
            device: self.store.device(),
            window: match &self.backbone {
                Backbone::Newest { .. } => 1,
                Backbone::Window(network) => network.spec.window(),
            },
            chunk,
            width: usize::try_from(self.size.width * self.image_tokens()).unwrap_or(0),
        }
    }
}
