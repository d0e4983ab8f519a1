//! Whether a policy switches when the experts do: what it gives at the few steps at which a binary action value changes,
//! such as the one at which a gripper closes. A loss over all steps hardly shows them, and a policy that reads the value
//! off an observation that follows it, such as a finger, is right at all others. Independent of the kind of policy.

use tch::no_grad_guard;

use super::kind::PolicyModel;
use super::shares::{Inputs, first_actions, inputs};
use super::source::Source;
use crate::batch::{Segment, Segments, values};
use crate::error::LearnError;
use crate::shape::TaskShape;
use crate::trajectory::Trajectory;

/// The metric.
pub(super) const SWITCHES_FOLLOWED: &str = "switches_followed";
/// Switches that are tried: an even part of all, when there are more.
const MOST: usize = 512;
/// Switches in a pass.
const CHUNK: usize = 64;
/// Steps before and after a switch whose segments have its weight: those before it show when not to switch yet.
const BESIDE: usize = 2;

/// A step at which a binary value of the action changes.
#[derive(Debug, PartialEq)]
struct Switch {
    segment: Segment,
    /// The place of the value in the action, and its new value.
    value: (usize, f32),
}

/// Of the steps of experts at which a binary action value changes, the share at which the policy gives the new value;
/// `None` without such a step.
///
/// # Errors
/// When an episode cannot be read.
pub(super) fn switches_followed(
    policy: &dyn PolicyModel,
    source: &Source<'_>,
    hides_history: bool,
    seed: u64,
) -> Result<Option<f64>, LearnError> {
    let _no_grad = no_grad_guard();
    let info = policy.info();
    let all = switches(info.shape, &source.data, info.window)?;
    let tried: Vec<&Switch> = all.iter().step_by(all.len().div_ceil(MOST).max(1)).collect();
    let mut followed = 0_u32;
    for some in tried.chunks(CHUNK) {
        let segments: Vec<Segment> = some.iter().map(|switch| switch.segment).collect();
        let Inputs { images, proprioception, action } = inputs(policy, source, &segments)?;
        let given = first_actions(policy, (&images, &proprioception, &action), hides_history, (seed, 0));
        let given = values(&info.statistics.actions(&given));
        for (switch, given) in some.iter().zip(given.chunks(info.shape.action)) {
            let (at, new) = switch.value;
            followed += u32::from(executed(info.shape, given)[at] == new);
        }
    }
    #[expect(clippy::cast_precision_loss, reason = "at most a few hundred")]
    let share = f64::from(followed) / tried.len() as f64;
    Ok((!tried.is_empty()).then_some(share))
}

/// Every segment of these experts, those around a switch with this weight relative to all others; their mean is 1.
///
/// # Errors
/// When an episode cannot be read.
pub(super) fn weighted(shape: &TaskShape, experts: &[&Trajectory], weight: f64) -> Result<Segments, LearnError> {
    if weight == 1.0 {
        return Ok(Segments::every(experts));
    }
    let mut weights: Vec<Vec<f64>> = experts.iter().map(|expert| vec![1.0; expert.steps()]).collect();
    for Switch { segment: Segment { trajectory, step, .. }, .. } in switches(shape, experts, 1)? {
        let episode = &mut weights[trajectory];
        let end = episode.len().min(step + BESIDE + 1);
        episode[step.saturating_sub(BESIDE)..end].fill(weight);
    }
    #[expect(clippy::cast_precision_loss, reason = "far fewer segments than 2^52")]
    let mean = weights.iter().flatten().sum::<f64>() / weights.iter().map(Vec::len).sum::<usize>().max(1) as f64;
    #[expect(clippy::cast_possible_truncation, reason = "weights are f32")]
    let relative = |episode: Vec<f64>| episode.into_iter().map(|weight| (weight / mean) as f32).collect();
    Ok(Segments::weighted(weights.into_iter().map(relative)))
}

/// The switches of all episodes after whole windows.
fn switches(shape: &TaskShape, episodes: &[&Trajectory], window: usize) -> Result<Vec<Switch>, LearnError> {
    let binary: Vec<usize> = (0..shape.action).filter(|&at| shape.ranges.is_binary(at)).collect();
    let mut found = Vec::new();
    if binary.is_empty() {
        return Ok(found);
    }
    for (trajectory, data) in episodes.iter().enumerate() {
        let actions = data.actions()?;
        let rows: Vec<Vec<f32>> = actions.chunks(shape.action).map(|row| executed(shape, row)).collect();
        for step in window.max(1)..rows.len() {
            let changes = binary.iter().filter(|&&at| rows[step][at] != rows[step - 1][at]);
            let segment = Segment { trajectory, step, weight: 1.0 };
            found.extend(changes.map(|&at| Switch { segment, value: (at, rows[step][at]) }));
        }
    }
    Ok(found)
}

/// An action as a robot executes it.
fn executed(shape: &TaskShape, action: &[f32]) -> Vec<f32> {
    let mut action = action.to_vec();
    shape.ranges.apply(&mut action);
    action
}

#[cfg(test)]
mod tests {
    use gleaner_core::action::{ActionRange, ActionRanges};

    use gleaner_core::kinds::Family;
    use gleaner_core::{Chosen, TrainSpec};

    use super::super::{Pretrained, train_policy};
    use super::*;
    use crate::toy::{self, Recorder};

    /// Where the second action value, 0 or 1, changes.
    const STEP: usize = 12;

    fn shape() -> TaskShape {
        let ranges: ActionRanges = [ActionRange::Free, ActionRange::Binary(0.0, 1.0)].into_iter().collect();
        TaskShape { ranges, ..toy::shape() }
    }

    /// Experts with a switch that an observation has `late` steps later, and another one at once, but also before, in vain.
    fn experts(late: usize) -> Vec<Trajectory> {
        let change = |expert: &Trajectory| {
            expert.changed(|arrays| {
                for step in 0..arrays.action.len() / 2 {
                    arrays.action[2 * step + 1] = f32::from(u8::from(step >= STEP));
                    arrays.proprioception[3 * step + 1] = f32::from(u8::from(step >= STEP || (3..6).contains(&step)));
                    arrays.proprioception[3 * step + 2] = f32::from(u8::from(step >= STEP + late));
                }
            })
        };
        toy::experts(6, 24).iter().map(change).collect()
    }

    fn followed(late: usize, switch_weight: f64) -> Vec<f64> {
        let mut monitor = Recorder::default();
        let policy = Chosen::new(Family::Policy, "bc").unwrap();
        let spec = TrainSpec { policy, switch_weight, ..toy::train_spec(150) };
        train_policy(&shape(), Pretrained::default(), &experts(late), &[], &spec, None, &mut monitor).unwrap();
        monitor.metric(SWITCHES_FOLLOWED)
    }

    #[test]
    fn a_policy_that_copies_an_observation_follows_no_switch() {
        assert_eq!(followed(0, 1.0), [1.0], "the observation tells when to switch");
        assert_eq!(followed(1, 1.0), [0.0], "the observation follows the action");
        assert!(followed(1, 30.0)[0] > 0.5, "of the steps that look alike, the one at which to switch counts");
    }

    #[test]
    fn segments_around_a_switch_weigh_more_and_the_mean_is_one() {
        let experts = experts(1);
        let data: Vec<&Trajectory> = experts.iter().collect();
        let found = weighted(&shape(), &data, 10.0).unwrap();
        let of = |place: usize| found.at(place).weight;
        // Five of the 24 segments of each expert.
        let one = 24.0 / (19.0 + 5.0 * 10.0);
        for (step, times) in [(0, 1.0), (9, 1.0), (10, 10.0), (14, 10.0), (15, 1.0)] {
            assert!((of(24 + step) - one * times).abs() < 1e-6, "{step}: {}", of(24 + step));
        }
        assert_eq!(found.count(), 6 * 24);
        let mean = (0..found.count()).map(of).sum::<f32>() / 144.0;
        assert!((mean - 1.0).abs() < 1e-5, "{mean}");
        let alike = weighted(&toy::shape(), &data, 10.0).unwrap();
        assert!((0..144).all(|place| alike.at(place).weight == 1.0), "no value is binary");
    }

    #[test]
    fn switches_are_found_after_whole_windows() {
        let experts = experts(1);
        let data: Vec<&Trajectory> = experts.iter().collect();
        let found = switches(&shape(), &data, 3).unwrap();
        assert_eq!(found.len(), 6);
        assert_eq!(found[1], Switch { segment: Segment { trajectory: 1, step: STEP, weight: 1.0 }, value: (1, 1.0) });
        assert_eq!(switches(&shape(), &data, STEP + 1).unwrap(), [], "its window begins before the episode");
        assert_eq!(switches(&toy::shape(), &data, 3).unwrap(), [], "no value is binary");
    }
}
