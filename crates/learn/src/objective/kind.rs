//! The definition of an objective: its loss on the passes over a batch. Must not depend on the list of objectives.

use gleaner_core::kinds::{Kind, Needs};
use tch::Tensor;

use super::Passes;

/// One self-supervised objective of pretraining.
pub(crate) struct Objective {
    /// The word in settings, such as `mtp`.
    pub(super) name: &'static str,
    /// The name for people.
    pub(super) title: &'static str,
    /// Description in one sentence.
    pub(super) about: &'static str,
    /// The name of its loss among the metrics.
    pub(crate) metric: &'static str,
    /// Whether it trains the pass in which all elements attend to each other, the source of features; otherwise it
    /// trains the causal pass.
    pub(super) bidirectional: bool,
    /// Its loss, a scalar to minimise.
    pub(crate) loss: fn(&Passes<'_>) -> Tensor,
}

impl Objective {
    /// Its description as data.
    pub(super) fn describe(&self) -> Kind {
        let [name, title, about] = [self.name, self.title, self.about].map(str::to_owned);
        Kind { name, title, about, needs: Needs::default(), settings: Vec::new() }
    }
}
