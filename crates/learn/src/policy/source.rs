//! A source of training batches, which a thread of its own assembles, and the mean loss of a batch drawn from it.
//! Independent of the policy.

use gleaner_core::TrainSpec;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use tch::Tensor;

use super::kind::{Form, Losses, PolicyInput, PolicyModel};
use crate::augment::augment;
use crate::batch::{Batch, Chunks, Segment, Segments, Windows};
use crate::error::LearnError;
use crate::normalize::Standard;
use crate::random::{Purpose, generator};
use crate::shape::TaskShape;
use crate::trajectory::Trajectory;

/// Episodes and the segments of them that count.
pub(super) struct Source<'a> {
    pub(super) data: Vec<&'a Trajectory>,
    pub(super) segments: Segments,
}

/// The parameters of one batch's random numbers: seed, number, and the purposes of segments, images, noise.
pub(super) struct Draw {
    pub(super) seed: u64,
    pub(super) batch: u64,
    pub(super) purposes: [Purpose; 3],
}

/// What a policy and its settings say of its training batches.
pub(super) struct Assembly<'a> {
    form: Form<'a>,
    /// That of the proprioception.
    standard: Standard,
    history_dropout: f64,
    spec: &'a TrainSpec,
}

impl<'a> Assembly<'a> {
    /// For `policy`, whose task has this `shape`.
    pub(super) fn new(policy: &dyn PolicyModel, shape: &'a TaskShape, spec: &'a TrainSpec) -> Self {
        let info = policy.info();
        let (device, window, chunk) = (info.device, info.window, info.chunk);
        Self {
            form: Form { shape, device, window, chunk },
            standard: info.statistics.proprioception.shared(),
            history_dropout: policy.history_dropout(),
            spec,
        }
    }
}

/// A batch of one source, ready for its loss.
pub(super) struct Assembled {
    batch: Batch,
    wanted: Chunks,
    /// As [`PolicyInput::hidden`].
    hidden: Option<Tensor>,
    /// For the random parts of the loss.
    noise: ChaCha8Rng,
}

impl Assembled {
    /// Mean of weight · −log P, and its terms; `weigh` gives the weights of the segments' qualities.
    pub(super) fn loss(self, policy: &dyn PolicyModel, weigh: impl Fn(&Tensor) -> Tensor) -> (Tensor, Losses) {
        let Self { mut batch, wanted, hidden, mut noise } = self;
        batch.weight = weigh(&batch.weight);
        mean_loss(policy, batch, hidden, &wanted, &mut noise)
    }
}

impl Source<'_> {
    /// A batch drawn from this source.
    pub(super) fn assemble(&self, of: &Assembly<'_>, draw: &Draw) -> Result<Assembled, LearnError> {
        let [mut segments, mut images, mut noise] =
            draw.purposes.map(|purpose| generator(draw.seed, purpose, draw.batch));
        let drawn = self.segments.draw(&mut segments, of.spec.optim.batch, of.spec.optim.stretch);
        let (mut batch, wanted) = self.collect(&of.form, &drawn)?;
        augment(&mut batch, &of.spec.augmentation, &of.standard, &mut images);
        let hidden = hide_past(&batch.windows, of.history_dropout, &mut noise);
        Ok(Assembled { batch, wanted, hidden, noise })
    }

    /// The steps of `drawn` segments, and their actions to predict.
    pub(super) fn collect(&self, form: &Form<'_>, drawn: &[Segment]) -> Result<(Batch, Chunks), LearnError> {
        let batch = Batch::collect(form.shape, &self.data, drawn, form.window, form.device)?;
        let runs = drawn.iter().map(|segment| (*segment, self.segments.run(segment, form.chunk)));
        let runs: Vec<(Segment, usize)> = runs.collect();
        let wanted = Chunks::collect(form.shape, &self.data, &runs, form.chunk, form.device)?;
        Ok((batch, wanted))
    }
}

/// All steps of a window but the last, for each window with chance `dropout`: `[W, L, 3]`. `None` if there is no past
/// to hide, or the chance is 0.
fn hide_past(windows: &Windows, dropout: f64, rng: &mut ChaCha8Rng) -> Option<Tensor> {
    if windows.length < 2 || dropout == 0.0 {
        return None;
    }
    let count = windows.valid_places.len() / windows.length;
    let hides: Vec<bool> = (0..count).map(|_| rng.random_bool(dropout)).collect();
    windows.past_of(&hides)
}

/// Mean of weight · −log P over `batch`; each of its frames is encoded once.
pub(super) fn mean_loss(
    policy: &dyn PolicyModel,
    batch: Batch,
    hidden: Option<Tensor>,
    wanted: &Chunks,
    noise: &mut ChaCha8Rng,
) -> (Tensor, Losses) {
    let Batch { images, seen_proprioception: proprioception, action, windows, weight, .. } = batch;
    let input = PolicyInput {
        embedded: policy.embed_images(&images),
        proprioception,
        action,
        windows,
        hidden,
        draws: Vec::new(),
    };
    let losses = policy.losses(&input, wanted, noise);
    ((&losses.each * weight).mean(None), losses)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::batch::values;

    #[test]
    fn the_past_is_hidden_as_often_as_asked_and_the_newest_step_never() {
        let windows = Windows::in_order(vec![true; 400 * 3], 3, tch::Device::Cpu);
        let mut rng = generator(1, Purpose::Style, 0);
        let hidden = hide_past(&windows, 0.25, &mut rng).unwrap();
        assert_eq!(hidden.size(), [400, 3, 3]);
        let each = values(&hidden.to_kind(tch::Kind::Float));
        let of_window: Vec<f32> = each.chunks(9).map(|window| window[..6].iter().sum()).collect();
        assert!(each.chunks(9).all(|window| window[6..].iter().all(|h| *h == 0.0)));
        assert!(of_window.iter().all(|sum| *sum == 0.0 || *sum == 6.0), "a past is hidden as one");
        let count = of_window.iter().filter(|sum| **sum > 0.0).count();
        assert!((70..130).contains(&count), "{count} of 400");
        assert!(hide_past(&windows, 0.0, &mut rng).is_none());
        assert!(hide_past(&Windows::in_order(vec![true; 4], 1, tch::Device::Cpu), 1.0, &mut rng).is_none());
    }
}
