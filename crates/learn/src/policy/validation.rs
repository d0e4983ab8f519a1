//! Experts that a training does not see, and a policy's loss on them: the measure of overfitting. Independent of the
//! kind of policy.

use gleaner_core::TrainSpec;
use rand::seq::SliceRandom;
use tch::no_grad_guard;

use super::kind::PolicyModel;
use super::source::{Source, mean_loss};
use crate::batch::Segment;
use crate::error::LearnError;
use crate::random::{Purpose, generator};
use crate::trajectory::Trajectory;

/// Segments on which the loss is measured: an even part of all, when there are more.
const SEGMENTS: usize = 256;
/// Segments in a pass.
const CHUNK: usize = 64;

/// The experts to learn from, and those that are held out: the share of `spec`, but at least one of each if there are
/// two. The seed alone decides which, so that two policies of one seed are measured on the same ones.
pub(super) fn split<'a>(experts: &'a [Trajectory], spec: &TrainSpec) -> (Vec<&'a Trajectory>, Vec<&'a Trajectory>) {
    let all: Vec<&Trajectory> = experts.iter().collect();
    if spec.validation_share == 0.0 || all.len() < 2 {
        return (all, Vec::new());
    }
    #[expect(clippy::cast_precision_loss, reason = "a count of episodes")]
    let share = spec.validation_share * all.len() as f64;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "below the count of episodes")]
    let count = (share.round() as usize).clamp(1, all.len() - 1);
    let mut order: Vec<usize> = (0..all.len()).collect();
    order.shuffle(&mut generator(spec.run.seed, Purpose::Validation, 0));
    let mut held_out = vec![false; all.len()];
    order.into_iter().take(count).for_each(|place| held_out[place] = true);
    let of =
        |wanted: bool| all.iter().zip(&held_out).filter(|(_, held)| **held == wanted).map(|(one, _)| *one).collect();
    (of(false), of(true))
}

/// The mean loss on `held_out`, without changes to its inputs and with the same random parts every time; `None` if no
/// expert is held out.
pub(super) fn loss(policy: &dyn PolicyModel, held_out: &Source<'_>, seed: u64) -> Result<Option<f64>, LearnError> {
    let _no_grad = no_grad_guard();
    let all = held_out.segments.count();
    let every = all.div_ceil(SEGMENTS).max(1);
    let measured: Vec<Segment> = (0..all).step_by(every).map(|place| held_out.segments.at(place)).collect();
    let mut rng = generator(seed, Purpose::Validation, 1);
    let (mut sum, mut count) = (0.0, 0.0);
    for chunk in measured.chunks(CHUNK) {
        let (batch, wanted) = held_out.collect(&policy.info().form(), chunk)?;
        #[expect(clippy::cast_precision_loss, reason = "at most a chunk")]
        let size = chunk.len() as f64;
        sum += mean_loss(policy, batch, None, &wanted, &mut rng).0.double_value(&[]) * size;
        count += size;
    }
    Ok((count > 0.0).then(|| sum / count))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::toy;

    fn spec(share: f64, seed: u64) -> TrainSpec {
        let mut spec = TrainSpec { validation_share: share, ..toy::train_spec(1) };
        spec.run.seed = seed;
        spec
    }

    #[test]
    fn a_share_of_the_experts_is_held_out_by_the_seed() {
        let experts = toy::experts(10, 3);
        let ids = |of: &[&Trajectory]| of.iter().map(|one| one.id.clone()).collect::<Vec<_>>();
        let (learned, held_out) = split(&experts, &spec(0.3, 1));
        assert_eq!((learned.len(), held_out.len()), (7, 3));
        assert!(held_out.iter().all(|held| learned.iter().all(|one| one.id != held.id)));
        assert_eq!(ids(&held_out), ids(&split(&experts, &spec(0.3, 1)).1));
        assert_ne!(ids(&held_out), ids(&split(&experts, &spec(0.3, 2)).1));
        for (share, count) in [(0.0, 0), (0.01, 1), (0.9, 9)] {
            assert_eq!(split(&experts, &spec(share, 1)).1.len(), count);
        }
        assert!(split(&experts[..1], &spec(0.5, 1)).1.is_empty(), "the only expert is learned from");
    }
}
