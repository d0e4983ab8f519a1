//! The steps over which statistics are measured. A pass reads one episode after the other and keeps none.

use std::borrow::Cow;

use crate::batch::Segments;
use crate::error::LearnError;
use crate::trajectory::Trajectory;

/// Steps of episodes.
pub(crate) struct Sample<'a> {
    sources: Vec<(Vec<&'a Trajectory>, Cow<'a, Segments>)>,
}

impl<'a> Sample<'a> {
    /// Every step of every episode.
    pub(crate) fn every(data: &[&'a Trajectory]) -> Self {
        Self { sources: vec![(data.to_vec(), Cow::Owned(Segments::every(data)))] }
    }

    /// The newest steps of the segments of each source, so that a rejected step has no influence.
    pub(crate) fn of_segments(sources: &[(&[&'a Trajectory], &'a Segments)]) -> Self {
        let each = sources.iter().map(|(data, segments)| (data.to_vec(), Cow::Borrowed(*segments)));
        Self { sources: each.collect() }
    }

    /// An even part of the sample: at most `most` steps.
    pub(super) fn some_steps(&self, most: usize) -> Vec<(&'a Trajectory, usize)> {
        let count: usize = self.sources.iter().map(|(_, segments)| segments.count()).sum();
        let (every, mut begin, mut steps) = (count.div_ceil(most).max(1), 0_usize, Vec::new());
        for (data, segments) in &self.sources {
            let first = begin.next_multiple_of(every) - begin;
            let chosen = (first..segments.count()).step_by(every).map(|place| segments.at(place));
            steps.extend(chosen.map(|segment| (data[segment.trajectory], segment.step)));
            begin += segments.count();
        }
        steps
    }

    /// Calls `visit` with the proprioception and the action of every step, in the same order each time.
    ///
    /// # Errors
    /// [`LearnError::Steps`].
    pub(crate) fn each(&self, visit: &mut dyn FnMut(&[f32], &[f32])) -> Result<(), LearnError> {
        for (data, segments) in &self.sources {
            for (at, episode) in data.iter().enumerate() {
                let (Some(first), Some(last)) = (segments.steps(at).next(), segments.steps(at).next_back()) else {
                    continue;
                };
                let numbers = episode.numbers(first..last + 1)?;
                let count = last + 1 - first;
                let (m, a) = (numbers.proprioception.len() / count, numbers.action.len() / count);
                for step in segments.steps(at).map(|step| step - first) {
                    visit(&numbers.proprioception[step * m..(step + 1) * m], &numbers.action[step * a..(step + 1) * a]);
                }
            }
        }
        Ok(())
    }
}
