//! Whether a policy switches when the experts do: what it gives at the few steps at which a binary action value changes,
//! such as the one at which a gripper closes. A loss over all steps hardly shows them, and a policy that reads the value
//! off an observation that follows it, such as a finger, is right at all others. Independent of the kind of policy.

use tch::no_grad_guard;

use super::kind::PolicyModel;
use super::shares::{Inputs, first_actions, inputs};
use super::source::Source;
use crate::batch::{Segment, values};
use crate::error::LearnError;
use crate::shape::TaskShape;

/// The metric.
pub(super) const SWITCHES_FOLLOWED: &str = "switches_followed";
/// Switches that are tried: an even part of all, when there are more.
const MOST: usize = 512;
/// Switches in a pass.
const CHUNK: usize = 64;

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
    let all = switches(info.shape, source, info.window)?;
    let tried: Vec<&Switch> = all.iter().step_by(all.len().div_ceil(MOST).max(1)).collect();
    let mut followed = 0_u32;
    for some in tried.chunks(CHUNK) {
        let segments: Vec<Segment> = some.iter().map(|switch| switch.segment).collect();
        let Inputs { images, proprioception, action } = inputs(policy, source, &segments)?;
        let given = first_actions(policy, (&images, &proprioception, &action), hides_history, seed);
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

/// The switches of all episodes after whole windows.
fn switches(shape: &TaskShape, source: &Source<'_>, window: usize) -> Result<Vec<Switch>, LearnError> {
    let binary: Vec<usize> = (0..shape.action).filter(|&at| shape.ranges.is_binary(at)).collect();
    let mut found = Vec::new();
    if binary.is_empty() {
        return Ok(found);
    }
    for (trajectory, data) in source.data.iter().enumerate() {
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
    use crate::batch::Segments;
    use crate::toy::{self, Recorder};
    use crate::trajectory::Trajectory;

    /// Where the second action value, 0 or 1, changes.
    const STEP: usize = 12;

    fn shape() -> TaskShape {
        let ranges: ActionRanges = [ActionRange::Free, ActionRange::Binary(0.0, 1.0)].into_iter().collect();
        TaskShape { ranges, ..toy::shape() }
    }

    /// Experts with a switch that an observation has `late` steps later.
    fn experts(late: usize) -> Vec<Trajectory> {
        let change = |expert: &Trajectory| {
            expert.changed(|arrays| {
                for step in 0..arrays.action.len() / 2 {
                    arrays.action[2 * step + 1] = f32::from(u8::from(step >= STEP));
                    arrays.proprioception[3 * step + 2] = f32::from(u8::from(step >= STEP + late));
                }
            })
        };
        toy::experts(6, 24).iter().map(change).collect()
    }

    fn followed(late: usize) -> Vec<f64> {
        let mut monitor = Recorder::default();
        let spec = TrainSpec { policy: Chosen::new(Family::Policy, "bc").unwrap(), ..toy::train_spec(150) };
        train_policy(&shape(), Pretrained::default(), &experts(late), &[], &spec, None, &mut monitor).unwrap();
        monitor.metric(SWITCHES_FOLLOWED)
    }

    #[test]
    fn a_policy_that_copies_an_observation_follows_no_switch() {
        assert_eq!(followed(0), [1.0], "the observation tells when to switch");
        assert_eq!(followed(1), [0.0], "the observation follows the action");
    }

    #[test]
    fn switches_are_found_after_whole_windows() {
        let experts = experts(1);
        let data: Vec<&Trajectory> = experts.iter().collect();
        let source = Source { segments: Segments::every(&data), data: data.clone() };
        let found = switches(&shape(), &source, 3).unwrap();
        assert_eq!(found.len(), 6);
        assert_eq!(found[1], Switch { segment: Segment { trajectory: 1, step: STEP, weight: 1.0 }, value: (1, 1.0) });
        assert_eq!(switches(&shape(), &source, STEP + 1).unwrap(), [], "its window begins before the episode");
        assert_eq!(switches(&toy::shape(), &source, 3).unwrap(), [], "no value is binary");
    }
}
