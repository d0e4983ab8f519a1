//! The choice of a batch's segments: stretches of neighbours in the list, so that the frames they share are encoded once.
//! Every segment is equally likely, however few of its episode are listed. And the choice of an even part of a list.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

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

/// Segments to draw from, sorted by episode and step. An episode whose every step ends a segment takes no memory for
/// them.
#[derive(Debug, Clone)]
pub(crate) struct Segments {
    episodes: Vec<Ends>,
    /// First segment of each episode, and the number of segments as the last entry.
    bounds: Vec<usize>,
}

/// The steps of one episode that end a segment.
#[derive(Debug, Clone)]
enum Ends {
    /// Every step, each with weight 1.
    Every(usize),
    /// These steps, sorted, with their weights.
    Kept(Vec<(u32, f32)>),
}

impl Ends {
    fn count(&self) -> usize {
        match self {
            Self::Every(count) => *count,
            Self::Kept(kept) => kept.len(),
        }
    }

    fn at(&self, place: usize) -> (usize, f32) {
        match self {
            Self::Every(_) => (place, 1.0),
            Self::Kept(kept) => (kept[place].0 as usize, kept[place].1),
        }
    }
}

impl Segments {
    /// Every segment of every episode, weight 1.
    pub(crate) fn every(data: &[&Trajectory]) -> Self {
        Self::from_ends(data.iter().map(|trajectory| Ends::Every(trajectory.steps())))
    }

    /// Every segment of every episode, with the weight of each step.
    pub(crate) fn weighted(weights: impl IntoIterator<Item = Vec<f32>>) -> Self {
        Self::from_ends(weights.into_iter().map(|weights| Ends::Kept((0..).zip(weights).collect())))
    }

    /// The kept segments with their weights.
    pub(crate) fn kept(kept: &[WeightedSegments]) -> Self {
        Self::from_ends(kept.iter().map(|episode| {
            let mut ends = episode.steps.clone();
            ends.sort_by_key(|(step, _)| *step);
            Ends::Kept(ends)
        }))
    }

    fn from_ends(ends: impl Iterator<Item = Ends>) -> Self {
        let (mut episodes, mut bounds, mut count) = (Vec::new(), vec![0], 0);
        for ends in ends {
            count += ends.count();
            bounds.push(count);
            episodes.push(ends);
        }
        Self { episodes, bounds }
    }

    /// Number of segments.
    pub(crate) fn count(&self) -> usize {
        self.bounds.last().copied().unwrap_or(0)
    }

    /// The segment at a place of the list.
    pub(crate) fn at(&self, place: usize) -> Segment {
        let trajectory = self.bounds.partition_point(|bound| *bound <= place) - 1;
        let (step, weight) = self.episodes[trajectory].at(place - self.bounds[trajectory]);
        Segment { trajectory, step, weight }
    }

    /// All segments.
    pub(crate) fn all(&self) -> Vec<Segment> {
        (0..self.count()).map(|place| self.at(place)).collect()
    }

    /// The steps that end a segment of an episode, ascending.
    pub(crate) fn steps(&self, trajectory: usize) -> impl DoubleEndedIterator<Item = usize> {
        let ends = &self.episodes[trajectory];
        (0..ends.count()).map(|place| ends.at(place).0)
    }

    /// Whether there is no segment to draw.
    pub(crate) fn is_empty(&self) -> bool {
        self.count() == 0
    }

    /// The number of consecutive steps, starting at the end of `segment` and at most `limit`, that end a segment of the
    /// list.
    pub(crate) fn run(&self, segment: &Segment, limit: usize) -> usize {
        match &self.episodes[segment.trajectory] {
            Ends::Every(count) => (count - segment.step).min(limit),
            Ends::Kept(kept) => {
                let from = kept.partition_point(|(step, _)| (*step as usize) < segment.step);
                let mut run = 0;
                for (step, _) in &kept[from..] {
                    let step = *step as usize;
                    if run == limit || step > segment.step + run {
                        break;
                    }
                    run = step - segment.step + 1;
                }
                run
            }
        }
    }

    /// Draws `count` segments in stretches of `stretch`, each from a random place of the list on. The list is a ring, and
    /// a stretch continues in the next episode where its own ends, which makes all segments equally likely.
    pub(crate) fn draw(&self, rng: &mut ChaCha8Rng, count: u32, stretch: u32) -> Vec<Segment> {
        let (count, stretch) = (count as usize, stretch as usize);
        let mut drawn = Vec::with_capacity(count);
        while drawn.len() < count && !self.is_empty() {
            let anchor = rng.random_range(0..self.count());
            let length = stretch.min(count - drawn.len());
            drawn.extend((anchor..anchor + length).map(|place| self.at(place % self.count())));
        }
        drawn
    }
}

/// At most `most` of `count` places, ascending: one of each run of as many places as needed. Its position in the run
/// differs from run to run (multiples of the golden ratio), because with equal positions episodes whose length is a
/// multiple of a run's would give the same few of their steps.
pub(crate) fn spread(count: usize, most: usize) -> impl Iterator<Item = usize> {
    /// 2^64 over the golden ratio.
    const STEP: u64 = 0x9E37_79B9_7F4A_7C15;
    let run = count.div_ceil(most.max(1)).max(1);
    (0..count).step_by(run).zip(0u64..).map(move |(begin, number)| {
        let within = u128::from(number.wrapping_mul(STEP)) * run.min(count - begin) as u128;
        begin + usize::try_from(within >> 64).unwrap_or(0)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::batch::Windows;
    use crate::random::{Purpose, generator};
    use crate::toy;

    #[test]
    fn an_even_part_has_a_place_of_each_run_and_every_phase() {
        assert_eq!(spread(5, 9).collect::<Vec<_>>(), [0, 1, 2, 3, 4]);
        assert_eq!((spread(0, 4).count(), spread(4, 1).count()), (0, 1));
        let places: Vec<usize> = spread(1003, 100).collect();
        assert_eq!(places.len(), 92);
        assert!(places.iter().enumerate().all(|(run, place)| (run * 11..(run * 11 + 11).min(1003)).contains(place)));
        // 100 episodes of ten steps: every step of an episode is found equally often.
        let mut phases = [0; 10];
        spread(1000, 100).for_each(|place| phases[place % 10] += 1);
        assert!(phases.iter().all(|count| (9..=11).contains(count)), "{phases:?}");
    }

    fn segments(lengths: &[usize]) -> Segments {
        Segments::from_ends(lengths.iter().map(|n| Ends::Every(*n)))
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

    /// 3 to 30 kept steps in each of 40 episodes, listed in any order: runs of up to 20 neighbours, 6.8 in the mean
    /// (6.9 to 11.2 in four selections of the embedded simulator with β 0.5).
    fn selection() -> Vec<WeightedSegments> {
        let trajectory = toy::episode("e", 1, 60, true);
        let episode = |number: usize| {
            let (runs, gaps) = ([2u32, 14, 5, 1, 20, 9, 8], [4u32, 1, 7, 2]);
            let mut next = u32::try_from(number * 5 % 20).unwrap();
            let runs = runs.iter().cycle().zip(gaps.iter().cycle()).skip(number);
            let ends = runs.flat_map(|(run, gap)| {
                let begin = next;
                next += run + gap;
                begin..begin + run
            });
            let mut steps: Vec<(u32, f32)> = ends.take(3 + number * 11 % 28).map(|step| (step, 1.0)).collect();
            steps.sort_by_key(|(step, _)| step * 7 % 31);
            WeightedSegments { trajectory: trajectory.clone(), steps }
        };
        (0..40).map(episode).collect()
    }

    /// A stretch of kept segments crosses gaps and ends of episodes, and still shares most of its frames. In the order
    /// in which `selection` lists the steps it would need 1.7 times as many.
    #[test]
    fn stretches_of_kept_segments_encode_less_than_a_third_more_frames_than_those_of_complete_episodes() {
        let kept = selection();
        let episodes: Vec<&Trajectory> = kept.iter().map(|episode| &episode.trajectory).collect();
        // The frames of 200 batches of 64 windows of 7 steps: each step of a batch once, as in `Batch::collect`.
        let frames = |segments: &Segments, stretch: u32| -> usize {
            let batch = |number| {
                let drawn = segments.draw(&mut generator(3, Purpose::KeptBatch, number), 64, stretch);
                Windows::places(&drawn, &[], 7).steps.len()
            };
            (0..200).map(batch).sum()
        };
        let (whole, kept) = (Segments::every(&episodes), Segments::kept(&kept));
        assert_eq!((kept.count(), whole.count()), (664, 2_400));
        // In a model of this drawing 107, 132 and 338 frames a batch, each with a standard error of at most 1.2.
        let [whole, kept, alone] = [frames(&whole, 8), frames(&kept, 8), frames(&kept, 1)];
        assert!(3 * kept < 4 * whole, "{kept} in stretches of eight, {whole} of complete episodes");
        assert!(2 * kept < alone, "{kept} in stretches of eight, {alone} one by one");
    }

    #[test]
    fn a_run_ends_where_a_step_is_not_kept_or_the_episode_ends() {
        let ends = [vec![(0, 1.0)], [2, 3, 3, 4, 7].map(|step| (step, 0.5)).to_vec()];
        let segments = Segments::from_ends(ends.into_iter().map(Ends::Kept));
        let runs: Vec<usize> = segments.all().iter().map(|segment| segments.run(segment, 10)).collect();
        assert_eq!(runs, [1, 3, 2, 2, 1, 1]);
        assert_eq!(segments.run(&segments.at(1), 2), 2);
        let every = super::tests::segments(&[4]);
        assert_eq!([(0, 9), (3, 9), (1, 2)].map(|(place, limit)| every.run(&every.at(place), limit)), [4, 1, 2]);
    }

    #[test]
    fn a_place_is_found_behind_episodes_without_segments() {
        let segments = segments(&[0, 2, 0, 0, 3, 0]);
        let found: Vec<_> = segments.all().iter().map(|segment| (segment.trajectory, segment.step)).collect();
        assert_eq!(found, [(1, 0), (1, 1), (4, 0), (4, 1), (4, 2)]);
        assert_eq!((segments.count(), segments.steps(4).collect()), (5, vec![0, 1, 2]));
    }

    #[test]
    fn nothing_to_draw_gives_nothing() {
        let drawn = segments(&[]).draw(&mut generator(1, Purpose::Batch, 0), 4, 2);
        assert!(drawn.is_empty());
    }
}
