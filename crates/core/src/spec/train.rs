//! The settings of training a policy.

use super::chosen::{Choice, Chosen, choice};
use super::groups::{Augmentation, OptimSpec, RunSpec, Validation};
use super::image_weights::{ImageWeights, ImageWeightsSpec};
use super::{stored, stored_as_values};
use crate::kinds::Family;
use crate::schema::{Problem, Setting, Values, number_in};
use crate::settings::Group as _;

crate::settings! {
    /// The weight of what is rare among the steps of experts.
    struct Switches {
        /// Weight, in the loss, of the expert segments that end within two steps of one at which a binary action value
        /// changes, beside 1 for all others; the mean stays 1. A gripper closes at one step of an episode, which a loss over
        /// all steps hardly shows: a larger weight makes a policy learn when to switch, and follow paths less precisely. 1:
        /// every segment alike, as in the paper.
        switch_weight: f64 = 1.0, number_in(1.0, 1000.0);
    }
}

crate::settings! {
    /// Changes to a policy's hidden values in training.
    struct Hidden {
        /// Chance of setting each hidden value to zero in a training step (0: none): of the outputs of attention and of the
        /// perceptrons within a transformer, and of the hidden layers of perceptrons that read images and proprioception; image
        /// encoders have none. Higher values reduce overfitting but need more steps.
        dropout: f64 = 0.0, number_in(0.0, 0.9);
    }
}

/// Settings of a training job.
#[derive(Debug, Clone, PartialEq)]
pub struct TrainSpec {
    /// The policy, with its own settings.
    pub policy: Chosen,
    /// Optimiser and batches: each batch is of `batch` expert and `batch` kept segments.
    pub optim: OptimSpec,
    /// The weighting of kept imperfect segments, with its own settings.
    pub weighting: Chosen,
    /// Share of the experts that are held out.
    pub validation_share: f64,
    /// Weight of the expert segments around a change of a binary action value.
    pub switch_weight: f64,
    /// Chance of each hidden value to be zero in a step.
    pub dropout: f64,
    /// Seed, checkpoints and device.
    pub run: RunSpec,
    /// Intra-op threads, set by the worker; `None` keeps the setting of the process.
    pub threads: Option<u32>,
}

impl Default for TrainSpec {
    fn default() -> Self {
        Self {
            policy: Chosen::first(Family::Policy),
            optim: OptimSpec::default(),
            weighting: Chosen::first(Family::Weighting),
            validation_share: Validation::default().validation_share,
            switch_weight: Switches::default().switch_weight,
            dropout: Hidden::default().dropout,
            run: RunSpec::default(),
            threads: None,
        }
    }
}

impl TrainSpec {
    /// Every setting that all policies have with the same default.
    #[must_use]
    pub fn schema() -> Vec<Setting> {
        let optim = OptimSpec::schema().into_iter().filter(|setting| !OptimSpec::is_of_policy(&setting.name));
        let own = [Validation::schema(), Switches::schema(), Hidden::schema()].concat();
        let groups = [own, optim.collect(), RunSpec::schema()];
        [vec![choice(Family::Policy), choice(Family::Weighting)], groups.concat()].concat()
    }

    /// Reads the settings; one that is left out takes its default.
    ///
    /// # Errors
    /// An unknown setting, one that the chosen policy or weighting does not use, or a value that is not allowed,
    /// alone or beside another.
    pub fn from_values(values: &Values) -> Result<Self, Problem> {
        let choices = [Choice::read(Family::Policy, values)?, Choice::read(Family::Weighting, values)?];
        let [policy, weighting] = &choices;
        let values = Choice::complete(&[policy, weighting], &Self::schema(), values)?;
        let optim = OptimSpec::read(&values)?;
        let validation_share = Validation::read(&values)?.checked(optim.finished_weights)?;
        let policy = policy.chosen(&values);
        ImageWeightsSpec::check_policy(&policy.settings)?;
        Ok(Self {
            policy,
            weighting: weighting.chosen(&values),
            optim,
            validation_share,
            switch_weight: Switches::read(&values)?.switch_weight,
            dropout: Hidden::read(&values)?.dropout,
            run: RunSpec::read(&values)?,
            threads: None,
        })
    }

    /// The weights that the policy's image encoder begins with.
    ///
    /// # Errors
    /// The text is not the name of a file; settings that were read before have none such.
    pub fn image_weights(&self) -> Result<ImageWeights, Problem> {
        self.policy.read().map(|ImageWeightsSpec { image_weights }| image_weights)
    }

    /// The steps before the newest one that the policy sees; `None` where the encoder decides that it begins from.
    #[must_use]
    pub fn history_steps(&self) -> Option<u64> {
        let set = |name: &str| self.policy.settings.get(name).and_then(serde_json::Value::as_u64);
        let begins_from_encoder = Family::Policy.find(&self.policy.name).is_none_or(|kind| kind.needs.encoder);
        set("history_steps").or_else(|| set("segment_length")).or((!begins_from_encoder).then_some(0))
    }

    /// Random changes to the policy's inputs.
    ///
    /// # Errors
    /// A value that is not allowed; settings that were read before have none such.
    pub fn augmentation(&self) -> Result<Augmentation, Problem> {
        self.policy.read()
    }

    /// The same settings with these changes to the policy's inputs.
    #[must_use]
    pub fn with_augmentation(mut self, augmentation: Augmentation) -> Self {
        augmentation.write(&mut self.policy.settings);
        self
    }

    /// The same settings with these weights of the policy's image encoder.
    #[must_use]
    pub fn with_image_weights(mut self, image_weights: ImageWeights) -> Self {
        ImageWeightsSpec { image_weights }.write(&mut self.policy.settings);
        self
    }

    /// Every setting with its value.
    #[must_use]
    pub fn values(&self) -> Values {
        let Self { policy, weighting, optim, validation_share, switch_weight, dropout, run, threads: _ } = self;
        let mut values = Values::new();
        policy.write(Family::Policy, &mut values);
        weighting.write(Family::Weighting, &mut values);
        Validation { validation_share: *validation_share }.write(&mut values);
        Switches { switch_weight: *switch_weight }.write(&mut values);
        Hidden { dropout: *dropout }.write(&mut values);
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

stored_as_values!(TrainSpec, stored::train);
