//! The choice of a batch's segments: stretches of neighbours in the list, so that the frames they share are encoded once.
//! Every segment is equally likely, however few of its episode are listed.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::shape::TaskShape;
use crate::trajectory::{Trajectory, WeightedSegments};

/// One segment: the window that ends at `step` of episode number `trajectory`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Segment {
    /// The episode, an index into the data.
    pub(crate) trajectory: usize,
    /// The step the window ends at.
    pub(crate) step: usize,
    /// Its weight in the loss.
    pub(crate) weight: f32,
}

/// Segments to draw from, sorted by episode and step.
#[derive(Debug)]
pub(crate) struct Segments {
    all: Vec<Segment>,
    /// First segment of each episode, and the number of segments as the last entry.
    bounds: Vec<usize>,
}

impl Segments {
    /// Every segment of every episode, weight 1.
    pub(crate) fn every(shape: &TaskShape, data: &[&Trajectory]) -> Self {
        let ends = data.iter().map(|trajectory| (0..trajectory.steps(shape)).map(|step| (step, 1.0)).collect());
        Self::from_ends(ends)
    }

    /// The kept segments with their weights.
    pub(crate) fn kept(kept: &[WeightedSegments]) -> Self {
        let ends = kept.iter().map(|episode| {
            let steps = episode.steps.iter();
            let mut ends: Vec<(usize, f32)> = steps.map(|(step, q)| (*step as usize, *q)).collect();
            ends.sort_by_key(|(step, _)| *step);
            ends
        });
        Self::from_ends(ends)
    }

    fn from_ends(ends: impl Iterator<Item = Vec<(usize, f32)>>) -> Self {
        let (mut all, mut bounds) = (Vec::new(), vec![0]);
        for (trajectory, ends) in ends.enumerate() {
            all.extend(ends.into_iter().map(|(step, weight)| Segment { trajectory, step, weight }));
            bounds.push(all.len());
        }
        Self { all, bounds }
    }

    /// All segments.
    pub(crate) fn all(&self) -> &[Segment] {
        &self.all
    }

    /// Whether there is no segment to draw.
    pub(crate) fn is_empty(&self) -> bool {
        self.all.is_empty()
    }

    /// The number of consecutive steps, starting at the end of `segment` and at most `limit`, that end a segment of the
    /// list.
    pub(crate) fn run(&self, segment: &Segment, limit: usize) -> usize {
        let episode = &self.all[self.bounds[segment.trajectory]..self.bounds[segment.trajectory + 1]];
        let from = episode.partition_point(|other| other.step < segment.step);
        let mut run = 0;
        for other in &episode[from..] {
            if run == limit || other.step > segment.step + run {
                break;
            }
            run = other.step - segment.step + 1;
        }
        run
    }

    /// Draws `count` segments in stretches of `stretch`, each from a random place of the list on. The list is a ring, and
    /// a stretch continues in the next episode where its own ends, which makes all segments equally likely.
    pub(crate) fn draw(&self, rng: &mut ChaCha8Rng, count: u32, stretch: u32) -> Vec<Segment> {
        let (count, stretch) = (count as usize, stretch as usize);
        let mut drawn = Vec::with_capacity(count);
        while drawn.len() < count && !self.all.is_empty() {
            let anchor = rng.random_range(0..self.all.len());
            let length = stretch.min(count - drawn.len());
            drawn.extend((anchor..anchor + length).map(|place| self.all[place % self.all.len()]));
        }
        drawn
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, generator};

    fn segments(lengths: &[usize]) -> Segments {
        Segments::from_ends(lengths.iter().map(|n| (0..*n).map(|t| (t, 1.0)).collect()))
    }

    #[test]
    fn a_batch_is_full_and_made_of_stretches_of_the_ring() {
        let segments = segments(&[30, 0, 50]);
        let drawn = segments.draw(&mut generator(1, Purpose::Batch, 0), 64, 8);
        assert_eq!(drawn.len(), 64);
        let place = |segment: &Segment| if segment.trajectory == 0 { segment.step } else { 30 + segment.step };
        for stretch in drawn.chunks(8) {
            for pair in stretch.windows(2) {
                assert_eq!((place(&pair[0]) + 1) % 80, place(&pair[1]));
            }
        }
    }

    /// Episodes with one, three and twelve kept segments: stretches that stopped at an episode's end drew those of the
    /// first 7.6 times less often than those of the last.
    #[test]
    fn kept_segments_are_equally_likely_however_few_an_episode_has() {
        let lengths = [1, 12, 3, 10, 30];
        let segments = segments(&lengths);
        let mut counts = lengths.map(|length| vec![0u32; length]);
        for step in 0..5_600 {
            for segment in segments.draw(&mut generator(3, Purpose::KeptBatch, step), 16, 8) {
                counts[segment.trajectory][segment.step] += 1;
            }
        }
        // 89,600 draws over 56 segments: 1,600 each, standard deviation about 110 for stretches.
        assert!(counts.iter().flatten().all(|n| (1_200..2_000).contains(n)), "{counts:?}");
    }

    #[test]
    fn a_run_ends_where_a_step_is_not_kept_or_the_episode_ends() {
        let ends = [vec![(0, 1.0)], [2, 3, 3, 4, 7].map(|step| (step, 0.5)).to_vec()];
        let segments = Segments::from_ends(ends.into_iter());
        let runs: Vec<usize> = segments.all().iter().map(|segment| segments.run(segment, 10)).collect();
        assert_eq!(runs, [1, 3, 2, 2, 1, 1]);
        assert_eq!(segments.run(&segments.all()[1], 2), 2);
    }

    #[test]
    fn nothing_to_draw_gives_nothing() {
        let drawn = segments(&[]).draw(&mut generator(1, Purpose::Batch, 0), 4, 2);
        assert!(drawn.is_empty());
    }
}
