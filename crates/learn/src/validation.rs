//! Episodes that a training does not see, and the mean of its loss over their segments: the measure of overfitting.
//! Independent of the loss.

use gleaner_core::FinishedWeights;
use rand::seq::SliceRandom;
use tch::no_grad_guard;

use crate::batch::{Segment, Segments, spread};
use crate::error::LearnError;
use crate::random::{Purpose, generator};
use crate::trajectory::Trajectory;

/// How often a training measures its loss on the episodes that it does not see.
const TIMES: u64 = 20;
/// Segments on which the loss is measured: an even part of all, when there are more.
const SEGMENTS: usize = 256;
/// Segments in a pass.
const CHUNK: usize = 64;

/// The episodes to learn from, and those that are held out: this share, rounded down, but at least one of each if there are
/// two and the weights with the lowest loss are wanted. The seed alone decides which, so that two trainings of one seed are
/// measured on the same ones.
///
/// # Errors
/// [`LearnError::Invalid`] for the field `of` if the weights with the lowest loss are wanted and no episode can be held
/// out.
pub(crate) fn split<'a>(
    episodes: &'a [Trajectory],
    (share, seed): (f64, u64),
    (finished, of): (FinishedWeights, &str),
) -> Result<(Vec<&'a Trajectory>, Vec<&'a Trajectory>), LearnError> {
    let all: Vec<&Trajectory> = episodes.iter().collect();
    if all.len() < 2 && finished == FinishedWeights::Best {
        let message = "has one episode, but finished_weights best holds one out; add another, or use last, ema or mean";
        return Err(LearnError::invalid(of, message));
    }
    if share == 0.0 || all.len() < 2 {
        return Ok((all, Vec::new()));
    }
    #[expect(clippy::cast_precision_loss, reason = "a count of episodes")]
    let share = share * all.len() as f64;
    let least = usize::from(finished == FinishedWeights::Best);
    // A share of 0.7 of ten episodes is seven of them, though 0.7 × 10 may be less than 7.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "below the count of episodes")]
    let count = ((share + 1e-9) as usize).clamp(least, all.len() - 1);
    let mut order: Vec<usize> = (0..all.len()).collect();
    order.shuffle(&mut generator(seed, Purpose::Validation, 0));
    let mut held_out = vec![false; all.len()];
    order.into_iter().take(count).for_each(|place| held_out[place] = true);
    let of =
        |wanted: bool| all.iter().zip(&held_out).filter(|(_, held)| **held == wanted).map(|(one, _)| *one).collect();
    Ok((of(false), of(true)))
}

/// Whether the loss is measured after `done` of `steps` steps.
pub(crate) fn due(done: u64, steps: u64) -> bool {
    done == steps || done.is_multiple_of(steps.div_ceil(TIMES))
}

/// The mean over segments of `held_out` of `loss`, which gives that of a chunk by its number and its segments; `None` without
/// any.
pub(crate) fn mean(
    held_out: &Segments,
    mut loss: impl FnMut(u64, &[Segment]) -> Result<f64, LearnError>,
) -> Result<Option<f64>, LearnError> {
    let _no_grad = no_grad_guard();
    let measured: Vec<Segment> = spread(held_out.count(), SEGMENTS).map(|place| held_out.at(place)).collect();
    let (mut sum, mut count) = (0.0, 0.0);
    for (number, chunk) in (0..).zip(measured.chunks(CHUNK)) {
        #[expect(clippy::cast_precision_loss, reason = "at most a chunk")]
        let size = chunk.len() as f64;
        sum += loss(number, chunk)? * size;
        count += size;
    }
    Ok((count > 0.0).then(|| sum / count))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::toy;

    #[test]
    fn a_share_of_the_episodes_is_held_out_by_the_seed() {
        let episodes = toy::experts(10, 3);
        let ids = |of: &[&Trajectory]| of.iter().map(|one| one.id.clone()).collect::<Vec<_>>();
        let split = |episodes, share, seed| split(episodes, (share, seed), (FinishedWeights::Last, "data")).unwrap();
        let (learned, held_out) = split(&episodes, 0.3, 1);
        assert_eq!((learned.len(), held_out.len()), (7, 3));
        assert!(held_out.iter().all(|held| learned.iter().all(|one| one.id != held.id)));
        assert_eq!(ids(&held_out), ids(&split(&episodes, 0.3, 1).1));
        assert_ne!(ids(&held_out), ids(&split(&episodes, 0.3, 2).1));
        for (share, count) in [(0.0, 0), (0.09, 0), (0.1, 1), (0.7, 7), (0.9, 9)] {
            assert_eq!(split(&episodes, share, 1).1.len(), count);
        }
        assert!(split(&episodes[..1], 0.5, 1).1.is_empty(), "the only episode is learned from");
        let best = super::split(&episodes, (0.01, 1), (FinishedWeights::Best, "data")).unwrap();
        assert_eq!(best.1.len(), 1, "without a loss none is the lowest");
    }

    #[test]
    fn the_loss_is_measured_at_even_steps_and_at_the_end() {
        let at = |steps: u64| (1..=steps).filter(|done| due(*done, steps)).collect::<Vec<_>>();
        assert_eq!(at(3), [1, 2, 3]);
        assert_eq!(at(50), [3, 6, 9, 12, 15, 18, 21, 24, 27, 30, 33, 36, 39, 42, 45, 48, 50]);
        assert_eq!(at(1000).len(), 20);
    }

    #[test]
    fn the_mean_is_over_an_even_part_of_all_segments() {
        let episodes = toy::experts(3, 200);
        let data: Vec<&Trajectory> = episodes.iter().collect();
        let mut sizes = Vec::new();
        let loss = mean(&Segments::every(&data), |number, chunk| {
            sizes.push(chunk.len());
            Ok(if number == 0 { 1.0 } else { 0.0 })
        });
        // 600 segments, every third.
        assert_eq!(sizes, [64, 64, 64, 8]);
        assert_eq!(loss.unwrap(), Some(64.0 / 200.0));
        assert_eq!(mean(&Segments::every(&[]), |_, _| Ok(1.0)).unwrap(), None);
    }

    /// Every fourth segment of 256 episodes of four steps would be their first steps, whose windows are mostly padding.
    #[test]
    fn the_mean_is_over_every_part_of_episodes_of_one_length() {
        let episodes = toy::experts(256, 4);
        let data: Vec<&Trajectory> = episodes.iter().collect();
        let mut ends = [0; 4];
        let count = |_: u64, chunk: &[Segment]| {
            chunk.iter().for_each(|segment| ends[segment.step] += 1);
            Ok(1.0)
        };
        mean(&Segments::every(&data), count).unwrap();
        assert!(ends.iter().all(|count| (60..=68).contains(count)), "{ends:?}");
    }
}
