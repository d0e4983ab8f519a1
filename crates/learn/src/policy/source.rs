//! A source of training batches, which threads of their own assemble, and the mean loss of a batch drawn from it.
//! Independent of the policy.

use gleaner_core::{Augmentation, TrainSpec};
use rand_chacha::ChaCha8Rng;
use tch::Tensor;

use super::hiding::HistorySpec;
use super::kind::{Form, Losses, PolicyInput, PolicyModel};
use crate::augment::augment;
use crate::batch::{Batch, Chunks, Drawn, Part, Segment, Segments};
use crate::dropout::{self, Dropout};
use crate::error::LearnError;
use crate::normalize::Standard;
use crate::random::{Purpose, generator};
use crate::shape::TaskShape;
use crate::train::Loss;
use crate::trajectory::Trajectory;

/// Episodes and the segments of them that count.
pub(super) struct Source<'a> {
    pub(super) data: Vec<&'a Trajectory>,
    pub(super) segments: Segments,
}

/// The parameters of one batch's random numbers: seed, number, and the purposes of segments, images, noise and dropout.
pub(super) struct Draw {
    pub(super) seed: u64,
    pub(super) batch: u64,
    pub(super) purposes: [Purpose; 4],
}

/// What a policy and its settings say of its training batches.
pub(super) struct Assembly<'a> {
    form: Form<'a>,
    /// That of the proprioception.
    standard: Standard,
    history: HistorySpec,
    augmentation: Augmentation,
    spec: &'a TrainSpec,
    part: Part,
}

impl<'a> Assembly<'a> {
    /// For `policy`, whose task has this `shape`, and a part of its batches.
    ///
    /// # Errors
    /// A setting of the augmentation that is not allowed.
    pub(super) fn new(
        policy: &dyn PolicyModel,
        shape: &'a TaskShape,
        spec: &'a TrainSpec,
        part: Part,
    ) -> Result<Self, LearnError> {
        let info = policy.info();
        let (device, window, chunk) = (info.device, info.window, info.chunk);
        Ok(Self {
            form: Form { shape, device, window, chunk },
            standard: info.statistics.proprioception.shared(),
            history: policy.history(),
            augmentation: spec.augmentation()?,
            spec,
            part,
        })
    }
}

/// A batch of one source, ready for its loss.
pub(super) struct Assembled {
    pub(super) batch: Batch,
    wanted: Chunks,
    /// As [`PolicyInput::hidden`].
    hidden: Option<Tensor>,
    /// For the random parts of the loss.
    noise: ChaCha8Rng,
    dropout: Dropout,
}

impl Assembled {
    /// This part's share of the mean of weight · −log P over the whole batch, and of its terms; `weigh` gives the weights
    /// of the segments' qualities.
    pub(super) fn loss(self, policy: &dyn PolicyModel, weigh: impl Fn(&Tensor) -> Tensor) -> Loss {
        let Self { mut batch, wanted, hidden, mut noise, dropout } = self;
        let share = batch.whole.share_of_windows();
        batch.weight = weigh(&batch.weight);
        let (mean, losses) = dropout::with(dropout, || mean_loss(policy, batch, hidden, &wanted, &mut noise));
        let parts = losses.parts.iter().map(|(name, each)| (*name, each.mean(None) * share)).collect();
        Loss { total: mean * share, parts }
    }
}

impl Source<'_> {
    /// A batch drawn from this source.
    pub(super) fn assemble(&self, of: &Assembly<'_>, draw: &Draw) -> Result<Assembled, LearnError> {
        let Draw { seed, batch, purposes: [segments, images, noise, dropped] } = *draw;
        let [mut segments, mut images, mut noise] =
            [segments, images, noise].map(|purpose| generator(seed, purpose, batch));
        let drawn = self.segments.draw(&mut segments, of.spec.optim.batch, of.spec.optim.stretch);
        let hides = of.history.hides(of.form.window, drawn.len(), &mut noise);
        let alone = if of.history.hides_steps() { hides.as_slice() } else { &[] };
        let drawn = Drawn { segments: &drawn, alone, part: of.part };
        let key = (seed, dropped, batch);
        let (mut batch, wanted) = self.collect_part(&of.form, drawn)?;
        augment(&mut batch, &of.augmentation, &of.standard, &mut images);
        // Also where no window is marked: what stands in for a hidden step then has a gradient in each step, of zeros, and
        // its moments decay alike in a run and in one that is resumed.
        let hidden = hides.get(batch.whole.windows.clone()).and_then(|own| of.history.mask(&batch.windows, own));
        let dropout = Dropout { chance: of.spec.dropout, key, windows: batch.whole.windows.clone() };
        Ok(Assembled { batch, wanted, hidden, noise, dropout })
    }

    /// The steps of `drawn` segments, and their actions to predict.
    pub(super) fn collect(&self, form: &Form<'_>, drawn: &[Segment]) -> Result<(Batch, Chunks), LearnError> {
        self.collect_part(form, Drawn { segments: drawn, alone: &[], part: Part::WHOLE })
    }

    /// As [`Source::collect`], of a part of `drawn`.
    fn collect_part(&self, form: &Form<'_>, drawn: Drawn<'_>) -> Result<(Batch, Chunks), LearnError> {
        let batch = Batch::collect_part(form.shape, &self.data, drawn, form.window, form.device)?;
        let own = drawn.segments[batch.whole.windows.clone()].iter();
        let runs: Vec<(Segment, usize)> =
            own.map(|segment| (*segment, self.segments.run(segment, form.chunk))).collect();
        let wanted = Chunks::collect(form.shape, &self.data, &runs, form.chunk, form.device)?;
        Ok((batch, wanted))
    }
}

/// Mean of weight · −log P over `batch`; each of its frames is encoded once.
pub(super) fn mean_loss(
    policy: &dyn PolicyModel,
    batch: Batch,
    hidden: Option<Tensor>,
    wanted: &Chunks,
    noise: &mut ChaCha8Rng,
) -> (Tensor, Losses) {
    let Batch { images, seen_proprioception, action, windows, weight, whole, proprioception: _ } = batch;
    let input = PolicyInput {
        embedded: policy.embed_images(&images),
        proprioception: seen_proprioception,
        action,
        windows,
        hidden,
        draws: Vec::new(),
        before: whole.windows.start,
    };
    let losses = policy.losses(&input, wanted, noise);
    ((&losses.each * weight).mean(None), losses)
}
