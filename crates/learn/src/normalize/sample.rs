//! The steps over which statistics are measured. Their values are read where they are: a sample copies nothing.

use crate::batch::Segments;
use crate::shape::TaskShape;
use crate::trajectory::Trajectory;

/// Steps of episodes.
pub(crate) struct Sample<'a> {
    data: Vec<&'a Trajectory>,
    /// (episode, an index into `data`; step).
    steps: Vec<(usize, usize)>,
}

impl<'a> Sample<'a> {
    /// Every step of every episode.
    pub(crate) fn every(shape: &TaskShape, data: &[&'a Trajectory]) -> Self {
        let mut sample = Self { data: Vec::new(), steps: Vec::new() };
        sample.add(data, &Segments::every(shape, data));
        sample
    }

    /// The newest steps of the segments of each source, so that a rejected step has no influence.
    pub(crate) fn of_segments(sources: &[(&[&'a Trajectory], &Segments)]) -> Self {
        let mut sample = Self { data: Vec::new(), steps: Vec::new() };
        for (data, segments) in sources {
            sample.add(data, segments);
        }
        sample
    }

    fn add(&mut self, data: &[&'a Trajectory], segments: &Segments) {
        let first = self.data.len();
        self.steps.extend(segments.all().iter().map(|segment| (first + segment.trajectory, segment.step)));
        self.data.extend_from_slice(data);
    }

    /// The images of each step of an even part of the sample: at most `most` steps.
    pub(super) fn frames(&self, shape: &TaskShape, most: usize) -> Vec<&'a [u8]> {
        let every = self.steps.len().div_ceil(most).max(1);
        self.steps.iter().step_by(every).map(|(episode, step)| self.data[*episode].frame(shape, *step)).collect()
    }

    /// One field of every step.
    pub(crate) fn rows<'s>(
        &'s self,
        of: impl Fn(&'a Trajectory, usize) -> &'a [f32] + Clone + 's,
    ) -> impl Iterator<Item = &'a [f32]> + Clone + 's
    where
        'a: 's,
    {
        self.steps.iter().map(move |(episode, step)| of(self.data[*episode], *step))
    }
}
