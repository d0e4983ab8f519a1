//! The settings of pretraining.

use super::groups::{Augmentation, ModelSpec, OptimSpec, RunSpec, Validation};
use super::image_weights::{ImageWeights, ImageWeightsSpec};
use super::{stored, stored_as_values};
use crate::kinds::Family;
use crate::schema::{Problem, Setting, Shape, Values, complete};
use crate::settings::{Group as _, take};

/// Settings of a pretraining job.
#[derive(Debug, Clone, PartialEq)]
pub struct PretrainSpec {
    /// The encoder to train.
    pub model: ModelSpec,
    /// The weights that its image encoder begins with.
    pub image_weights: ImageWeights,
    /// The objectives whose losses are added up, in the order of their list; all by default, as in the paper.
    pub objectives: Vec<String>,
    /// Random changes to inputs.
    pub augmentation: Augmentation,
    /// Optimiser and batches.
    pub optim: OptimSpec,
    /// Share of the episodes that are held out.
    pub validation_share: f64,
    /// Seed, checkpoints and device.
    pub run: RunSpec,
    /// Intra-op threads, set by the worker; `None` keeps the setting of the process. Numbers repeat bit for bit only
    /// between runs with the same number of threads.
    pub threads: Option<u32>,
}

impl Default for PretrainSpec {
    fn default() -> Self {
        Self {
            model: ModelSpec::default(),
            image_weights: ImageWeights::default(),
            objectives: Family::Objective.kinds().iter().map(|kind| kind.name.clone()).collect(),
            augmentation: Augmentation::default(),
            optim: OptimSpec::default(),
            validation_share: Validation::NONE.validation_share,
            run: RunSpec::default(),
            threads: None,
        }
    }
}

impl PretrainSpec {
    /// Steps of an encoder that gives scorers the statistics of its snapshot, and nothing that was learned.
    pub const UNTRAINED_STEPS: u64 = 1;

    /// The settings of such an encoder.
    #[must_use]
    pub fn untrained() -> Self {
        Self { optim: OptimSpec { steps: Self::UNTRAINED_STEPS, ..OptimSpec::default() }, ..Self::default() }
    }

    /// Whether these settings make such an encoder.
    #[must_use]
    pub fn is_untrained(&self) -> bool {
        self.optim.steps == Self::UNTRAINED_STEPS
    }

    /// Every setting.
    #[must_use]
    pub fn schema() -> Vec<Setting> {
        let model = [ModelSpec::schema(), ImageWeightsSpec::schema(), vec![objectives()]];
        let training = [Augmentation::schema(), Validation::NONE.as_defaults(), OptimSpec::schema(), RunSpec::schema()];
        [model.concat(), training.concat()].concat()
    }

    /// Reads the settings; one that is left out takes its default.
    ///
    /// # Errors
    /// An unknown setting, or a value that is not allowed, alone or beside another.
    pub fn from_values(values: &Values) -> Result<Self, Problem> {
        let values = complete(&Self::schema(), values, |_| None)?;
        let chosen: Vec<String> = take(&values, &objectives())?;
        let optim = OptimSpec::read(&values)?;
        let validation_share = Validation::read(&values)?.checked(optim.finished_weights)?;
        let (model, weights) = (ModelSpec::read(&values)?, ImageWeightsSpec::read(&values)?);
        weights.check(model)?;
        let listed = Family::Objective.kinds().iter().map(|kind| kind.name.clone());
        Ok(Self {
            model,
            image_weights: weights.image_weights,
            objectives: listed.filter(|name| chosen.contains(name)).collect(),
            augmentation: Augmentation::read(&values)?,
            optim,
            validation_share,
            run: RunSpec::read(&values)?,
            threads: None,
        })
    }

    /// Every setting with its value.
    #[must_use]
    pub fn values(&self) -> Values {
        let Self { model, image_weights, objectives, augmentation, optim, validation_share, run, threads: _ } = self;
        let mut values = Values::new();
        model.write(&mut values);
        ImageWeightsSpec { image_weights: image_weights.clone() }.write(&mut values);
        values.insert("objectives".to_owned(), objectives.clone().into());
        augmentation.write(&mut values);
        Validation { validation_share: *validation_share }.write(&mut values);
        optim.write(&mut values);
        run.write(&mut values);
        values
    }

    /// The settings that a resumed run must share with the run that wrote the checkpoint, as JSON.
    #[must_use]
    pub fn identity(&self) -> String {
        stored::identity(self.values())
    }
}

fn objectives() -> Setting {
    let words = Family::Objective.words();
    let default = words.iter().map(|known| known.word.clone()).collect::<Vec<_>>().into();
    let about = "Self-supervised objectives, whose losses are summed. Fewer objectives take less time.".to_owned();
    Setting { name: "objectives".to_owned(), about, shape: Shape::Words { words }, default }
}

stored_as_values!(PretrainSpec, stored::pretrain);
