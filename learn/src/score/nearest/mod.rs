//! Exact nearest search over expert segments.
//!
//! A single-precision matrix product per modality, ‖x − y‖² = ‖x‖² + ‖y‖² − 2 x·y after centring,
//! is the filter: it gives a lower bound of the distance with a proven margin. Whatever the bound
//! cannot rule out is compared again directly in double precision. So the winner and its distance
//! are exact and do not depend on tiles or threads. The product itself would not do: near zero,
//! where the best match is, its error exceeds the distance.

mod bound;
mod directions;
mod sweep;

use std::sync::Mutex;

use tch::{Device, Tensor};

use super::features::Features;
use super::similarity::Metric;
use crate::batch::rows;
use crate::device;
use bound::{Frame, Framed, factor};
use directions::Directions;
use sweep::Sweep;

/// Fewer pairs than this are not worth another thread.
const PAIRS_A_THREAD: usize = 1 << 17;

/// How much is compared at a time; the result does not depend on it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Tiles {
    pub(crate) queries: usize,
    pub(crate) experts: usize,
}

impl Default for Tiles {
    /// The products of a tile, their copy and the bounds stay within a core's cache.
    fn default() -> Self {
        Self { queries: 256, experts: 512 }
    }
}

/// A query's nearest expert segment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Match {
    /// The number its episode was given.
    pub episode: u32,
    /// The step it ends at.
    pub step: u32,
    /// The scaled sum of the distances.
    pub distance: f64,
    /// The distances of o, m and a.
    pub parts: [f32; 3],
}

impl Match {
    /// Nearer, or as near and of an earlier number, or of the same and an earlier step.
    fn beats(&self, other: &Option<Self>) -> bool {
        let order = |found: &Self| (found.distance, found.episode, found.step);
        other.as_ref().is_none_or(|other| order(self) < order(other))
    }
}

/// Some expert episodes' segments, ready to be compared with.
pub struct Reference {
    experts: Experts,
    /// Per level −2 × the experts' rows, `[N, d]` per modality.
    doubled: Vec<[Tensor; 3]>,
}

/// What threads share of it.
struct Experts {
    features: Features,
    /// The episodes' numbers, in rising order.
    numbers: Vec<u32>,
    /// Where each episode's segments begin, and at last where all end.
    bounds: Vec<usize>,
    metric: Metric,
    tiles: Tiles,
    frame: Frame,
    /// The cheaper first; the last rules out all that can be.
    levels: Vec<Level>,
}

/// How the filter sees the experts on one level.
struct Level {
    /// Along which directions; `None` for whole rows.
    directions: Option<[Directions; 3]>,
    /// Per modality and segment ‖x‖², as the filter wants it.
    squares: [Vec<f32>; 3],
    /// Per modality the most that bringing a segment here may have moved it.
    moved: [f64; 3],
    /// Per modality what its bounds are multiplied by.
    factors: [f32; 3],
}

impl Level {
    fn new(framed: &[Framed; 3], directions: Option<[Directions; 3]>, metric: &Metric) -> (Self, [Tensor; 3]) {
        let stretch = |i: usize| directions.as_ref().map_or(1.0, |directions| directions[i].stretch);
        let level = Self {
            squares: framed.each_ref().map(Framed::shrunk),
            moved: framed.each_ref().map(|framed| framed.moved.iter().fold(0.0, |a: f64, b| a.max(*b))),
            factors: [0, 1, 2].map(|i| factor(metric, i, stretch(i))),
            directions,
        };
        (level, framed.each_ref().map(|framed| rows(&framed.rows, framed.width, Device::Cpu) * -2.0))
    }
}

impl Reference {
    /// The segments of `episodes`, each with its number, in rising order. Searches on the CPU, where
    /// single precision is what it says.
    pub fn new(episodes: &[(u32, &Features)], metric: Metric) -> Self {
        Self::with_tiles(episodes, metric, Tiles::default())
    }

    pub(crate) fn with_tiles(episodes: &[(u32, &Features)], metric: Metric, tiles: Tiles) -> Self {
        let widths = episodes.first().map_or([1; 3], |(_, features)| features.widths());
        let mut features = Features::empty(widths);
        let mut bounds = vec![0];
        for (_, episode) in episodes {
            features.append(episode);
            bounds.push(features.count());
        }
        let frame = Frame::new(&features, metric.kind);
        let framed = [0, 1, 2].map(|modality| frame.apply(&features, modality, (0, features.count())));
        let mut levels = Vec::new();
        if let [Some(o), Some(m), Some(a)] = framed.each_ref().map(Directions::principal) {
            let directions = [o, m, a];
            let projected = std::array::from_fn(|i| directions[i].apply(&framed[i]));
            levels.push(Level::new(&projected, Some(directions), &metric));
        }
        levels.push(Level::new(&framed, None, &metric));
        let (levels, doubled) = levels.into_iter().unzip();
        let numbers = episodes.iter().map(|(number, _)| *number).collect();
        Self { experts: Experts { features, numbers, bounds, metric, tiles, frame, levels }, doubled }
    }

    /// Improves `matches`, one per query, by the nearest of these segments, leaving out the episode
    /// number `without`. What was there stays where none is nearer; a tie goes to the lowest
    /// episode number, then the first step.
    pub fn improve(&self, queries: &Features, without: Option<u32>, matches: &mut [Option<Match>]) {
        let threads = usize::try_from(tch::get_num_threads()).unwrap_or(1);
        let worth = queries.count() * self.experts.features.count() / PAIRS_A_THREAD;
        let ranges = self.experts.ranges(without);
        let size = self.experts.tiles.queries;
        let blocks = Mutex::new(matches.chunks_mut(size).enumerate());
        let sweeps: Vec<Sweep<'_>> = (0..threads.min(worth).max(1))
            .map(|_| Sweep::new(&self.experts, &self.doubled, queries, &ranges))
            .collect();
        device::side_by_side(sweeps, |mut sweep| {
            // A thread that failed cannot have left the list half taken from.
            let next = || blocks.lock().unwrap_or_else(std::sync::PoisonError::into_inner).next();
            while let Some((block, best)) = next() {
                sweep.block(block * size, best);
            }
        });
    }

    /// The nearest of these segments to each query, leaving out the episode number `without`;
    /// `None` if that leaves no expert.
    pub fn nearest(&self, queries: &Features, without: Option<u32>) -> Option<Vec<Match>> {
        let mut matches = vec![None; queries.count()];
        self.improve(queries, without, &mut matches);
        matches.into_iter().collect()
    }
}

impl Experts {
    /// Tiles over all segments but those of episode number `without`: (from, to).
    fn ranges(&self, without: Option<u32>) -> Vec<(usize, usize)> {
        let skipped = without.and_then(|number| self.numbers.binary_search(&number).ok());
        let all = self.features.count();
        let (start, end) = skipped.map_or((all, all), |at| (self.bounds[at], self.bounds[at + 1]));
        let tile = |range: (usize, usize)| {
            let begins = (range.0..range.1).step_by(self.tiles.experts);
            begins.map(move |begin| (begin, range.1.min(begin + self.tiles.experts)))
        };
        tile((0, start)).chain(tile((end, all))).collect()
    }

    /// The episode number and the step of segment `at`.
    fn place(&self, at: usize) -> (u32, u32) {
        let episode = self.bounds.partition_point(|bound| *bound <= at) - 1;
        (self.numbers[episode], u32::try_from(at - self.bounds[episode]).unwrap_or(u32::MAX))
    }

    /// Row `query` of `queries` against segment `at`, directly.
    fn compare(&self, queries: (&Features, usize), at: usize) -> Match {
        let parts = self.metric.parts(queries, (&self.features, at));
        let (episode, step) = self.place(at);
        #[expect(clippy::cast_possible_truncation, reason = "kept in single precision")]
        let single = parts.map(|part| part as f32);
        Match { episode, step, distance: self.metric.distance(parts), parts: single }
    }
}

#[cfg(test)]
mod tests;
