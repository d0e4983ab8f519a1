//! The actions that begin where each segment ends: the target of a policy. Needs no image.

use tch::{Device, Tensor};

use super::{Segment, Windows, allowed, int};
use crate::device::send;
use crate::error::LearnError;
use crate::shape::TaskShape;
use crate::trajectory::Trajectory;

/// The chunks a_t … a_{t+k−1} of W segments that end at their t.
pub(crate) struct Chunks {
    /// `[W, k, A]` in physical units, as the robot executes them; 0 where the action does not count.
    pub(crate) action: Tensor,
    /// `[W, k]` of `bool`: whether the action counts. The first one always counts.
    pub(crate) counted: Tensor,
}

impl Chunks {
    /// Chunks of `length` actions of segments of `data`. The number beside each segment is how many of its actions
    /// count; these must be within its episode.
    ///
    /// # Errors
    /// [`LearnError::Steps`].
    pub(crate) fn collect(
        shape: &TaskShape,
        data: &[&Trajectory],
        segments: &[(Segment, usize)],
        length: usize,
        device: Device,
    ) -> Result<Self, LearnError> {
        let (mut action, mut counted) = (Vec::new(), Vec::new());
        for (segment, count) in segments {
            let (end, count) = (action.len() + length * shape.action, length.min(*count));
            let mut wanted = data[segment.trajectory].numbers(segment.step..segment.step + count)?.action;
            allowed(shape, &mut wanted);
            action.extend(wanted);
            action.resize(end, 0.0);
            counted.extend((0..length).map(|ahead| ahead < count));
        }
        let size = [-1, int(length), int(shape.action)];
        Ok(Self {
            action: send(&Tensor::from_slice(&action).view(size), device),
            counted: Windows::grid(&counted, &size[..2], device),
        })
    }
}

#[cfg(test)]
mod tests {
    use gleaner_core::action::ActionRange;

    use super::*;
    use crate::batch::{Batch, values};
    use crate::toy;

    #[test]
    fn only_what_counts_is_there() {
        let data = toy::episode("e", 1, 6, true);
        let segment = |step| Segment { trajectory: 0, step, weight: 1.0 };
        let drawn = [(segment(1), 3), (segment(5), 1)];
        let chunks = Chunks::collect(&toy::shape(), &[&data], &drawn, 3, Device::Cpu).unwrap();
        assert_eq!(chunks.action.size(), [2, 3, 2]);
        assert_eq!(values(&chunks.action.get(0)), data.actions().unwrap()[2..8]);
        assert_eq!(values(&chunks.action.get(1)), [&data.actions().unwrap()[10..], &[0.0; 4]].concat());
        let counted = Vec::<Vec<bool>>::try_from(&chunks.counted).unwrap();
        assert_eq!(counted, [[true, true, true], [true, false, false]]);
    }

    #[test]
    fn actions_beyond_their_ranges_are_those_that_a_robot_executes() {
        let ranges = [ActionRange::Binary(-1.0, 1.0), ActionRange::Within(-0.01, 0.01)];
        let shape = TaskShape { ranges: ranges.into_iter().collect(), ..toy::shape() };
        let data = toy::episode("e", 1, 4, true);
        let mut executed = data.actions().unwrap();
        executed.chunks_exact_mut(2).for_each(|action| shape.ranges.apply(action));
        assert_ne!(executed, data.actions().unwrap());
        let end = Segment { trajectory: 0, step: 3, weight: 1.0 };
        let begin = Segment { step: 0, ..end };
        let chunks = Chunks::collect(&shape, &[&data], &[(begin, 4)], 4, Device::Cpu).unwrap();
        let batch = Batch::collect(&shape, &[&data], &[end], 4, Device::Cpu).unwrap();
        assert_eq!((values(&chunks.action), values(&batch.action)), (executed.clone(), executed));
    }
}
