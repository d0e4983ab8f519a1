//! The transformer's passes over one batch, each computed once and only if an objective needs it.

use std::cell::OnceCell;

use tch::Tensor;

use super::{Targets, masking};
use crate::batch::{Batch, Whole, Windows, int};
use crate::model::{Attention, Network, View};
use crate::random::{Purpose, generator};

/// The passes over a batch.
pub(crate) struct Passes<'a> {
    pub(super) network: &'a Network,
    pub(super) windows: &'a Windows,
    whole: &'a Whole,
    pub(super) targets: Targets,
    steps: Tensor,
    proprioception: &'a Tensor,
    seed: u64,
    step: u64,
    masked: OnceCell<Masked>,
}

/// The bidirectional pass over M(τ).
pub(super) struct Masked {
    /// Squared error of every element, `[W, L, 3]`.
    pub(super) errors: Tensor,
    /// The indicator I(e_t), `[W, L, 3]`.
    pub(super) masked: Tensor,
}

impl<'a> Passes<'a> {
    /// The passes of one training step; `seed` and `step` determine the masks.
    pub(crate) fn new(network: &'a Network, batch: &'a Batch, seed: u64, step: u64) -> Self {
        let steps = network.batch_steps(batch);
        let targets = Targets::new(network, batch);
        let (windows, whole, proprioception) = (&batch.windows, &batch.whole, &batch.seen_proprioception);
        Self { network, windows, whole, targets, steps, proprioception, seed, step, masked: OnceCell::new() }
    }

    /// The pass over M(τ), which MTP and TR share.
    pub(super) fn masked(&self) -> &Masked {
        self.masked.get_or_init(|| {
            let mut rng = generator(self.seed, Purpose::Mask, self.step);
            let masked = masking::draw(&mut rng, &self.whole.valid_places, self.windows.length);
            let elements = 3 * self.windows.length;
            let masked = &masked[self.whole.windows.start * elements..self.whole.windows.end * elements];
            let masked = Windows::grid(masked, &[-1, int(self.windows.length), 3], self.network.device());
            let view = View { attention: Attention::Bidirectional, hidden: Some(&masked) };
            let features = self.network.features(&self.steps, self.windows, view, self.windows.length);
            Masked { errors: self.targets.errors(self.network, &features), masked }
        })
    }

    /// The action predicted after each step's history, `[W, L, A]`.
    pub(super) fn actions(&self) -> Tensor {
        self.network.actions(&self.steps, self.proprioception, self.windows, None, self.windows.length)
    }
}
