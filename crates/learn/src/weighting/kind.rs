//! The definition of a weighting. Must not depend on the list of weightings.

use gleaner_core::kinds::{Kind, Needs};
use gleaner_core::schema::number_in;
use gleaner_core::{Chosen, Setting};
use tch::Tensor;

use crate::error::LearnError;

/// One kind of weighting: its description, its settings, and its constructor.
pub(super) struct WeightingKind {
    /// The word in settings, such as `quality`.
    pub(super) name: &'static str,
    /// The name for people.
    pub(super) title: &'static str,
    /// Description in one sentence.
    pub(super) about: &'static str,
    /// Its settings.
    pub(super) settings: fn() -> Vec<Setting>,
    /// The weighting with these settings.
    pub(super) open: fn(&Chosen) -> Result<Weighting, LearnError>,
}

impl WeightingKind {
    /// Its description as data.
    pub(super) fn describe(&self) -> Kind {
        let [name, title, about] = [self.name, self.title, self.about].map(str::to_owned);
        Kind { name, title, about, needs: Needs::default(), settings: (self.settings)() }
    }
}

gleaner_core::settings! {
    /// The settings of a weighting that adds the loss of kept segments to that of experts.
    #[derive(Copy)]
    pub(super) struct Added {
        /// Weight of the loss of kept imperfect segments relative to that of experts (λ; the paper has 0.1; 0: they are
        /// ignored). Higher values rely more on gleaned data.
        pub(super) lambda: f64 = 0.3, number_in(0.0, 1e6);
    }
}

/// A weighting with its settings: a training minimises the mean loss of experts plus λ times the mean of weight · loss
/// of kept segments.
pub(crate) struct Weighting {
    /// λ.
    pub(crate) lambda: f64,
    /// The weights, `[W]`, of kept segments from their qualities, `[W]`, 0 … 1.
    pub(super) of_quality: fn(&Tensor) -> Tensor,
}

impl Weighting {
    /// Whether no kept segment has a weight, so that none needs to be read.
    pub(crate) fn ignores_segments(&self) -> bool {
        self.lambda == 0.0
    }

    /// The weights, `[W]`, of kept segments with these qualities, `[W]`.
    pub(crate) fn weights(&self, qualities: &Tensor) -> Tensor {
        (self.of_quality)(qualities)
    }
}
