//! Exact nearest search over expert segments.
//!
//! Products per modality, ‖x − y‖² = ‖x‖² + ‖y‖² − 2 x·y after centring, are the filter: they give a
//! lower bound of the distance with a proven margin. First cheap products, of codes of one byte a
//! value or along few directions, then some in single precision where those leave too much.
//! Whatever the bound cannot rule out is compared again directly in double precision. So the winner
//! and its distance are exact and do not depend on tiles, threads or the processor. The product itself would not do: near zero,
//! where the best match is, its error exceeds the distance.

mod bound;
mod codes;
mod directions;
mod lanes;
mod level;
mod scan;
mod sweep;

use std::cell::OnceCell;
use std::sync::{Mutex, PoisonError};

use super::features::Features;
use super::similarity::Metric;
use crate::device;
use bound::Frame;
use codes::Codes;
use level::{Level, View};
use scan::Scan;
use sweep::Sweep;

/// Fewer pairs than this are not worth another thread.
const PAIRS_A_THREAD: usize = 1 << 17;
/// So many times the queries of a tile, and their values leave the cache.
const MOST_MORE: usize = 4;

/// How much is compared at a time; the result does not depend on it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Tiles {
    pub(crate) queries: usize,
    pub(crate) experts: usize,
}

impl Default for Tiles {
    /// The products of a tile and the bounds stay near a core.
    fn default() -> Self {
        Self { queries: 256, experts: 512 }
    }
}

impl Tiles {
    /// Queries to compare with `experts` at a time: more where those are few.
    fn queries_of(&self, experts: usize) -> usize {
        self.queries * (self.experts / experts.max(1)).clamp(1, MOST_MORE)
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
    /// The first filter, where the processor is made for it.
    codes: Option<Codes>,
    /// The filter for what that leaves, or leaves out: the cheaper views first; the last rules out
    /// all that can be.
    views: Vec<View>,
    levels: OnceCell<Vec<[Level; 3]>>,
}

/// What threads share of it.
struct Experts {
    features: Features,
    /// The episodes' numbers, in rising order.
    numbers: Vec<u32>,
    /// Where each episode's segments begin, and at last where all end.
    bounds: Vec<usize>,
    metric: Metric,
    /// The metric with the largest scale as the unit, so that the filter stays in range.
    relative: Metric,
    unit: f64,
    tiles: Tiles,
    frame: Frame,
}

impl Reference {
    /// The segments of `episodes`, each with its number, in rising order. Searches on the CPU, where
    /// single precision is what it says.
    pub fn new(episodes: &[(u32, &Features)], metric: Metric) -> Self {
        Self::with_tiles(episodes, metric, Tiles::default())
    }

    pub(crate) fn with_tiles(episodes: &[(u32, &Features)], metric: Metric, tiles: Tiles) -> Self {
        let mut reference = Self::with_views(episodes, metric, tiles, &[View::Along, View::Whole]);
        let experts = &reference.experts;
        reference.codes = Codes::new(&experts.features, &experts.frame, &experts.relative);
        if reference.codes.is_some() {
            // Whatever codes do not tell apart is not told apart along few directions.
            reference.views = vec![View::Whole];
        }
        reference
    }

    /// Without codes; the filter has the levels of `views` that pay.
    fn with_views(episodes: &[(u32, &Features)], metric: Metric, tiles: Tiles, views: &[View]) -> Self {
        let widths = episodes.first().map_or([1; 3], |(_, features)| features.widths());
        let mut features = Features::empty(widths);
        let mut bounds = vec![0];
        for (_, episode) in episodes {
            features.append(episode);
            bounds.push(features.count());
        }
        let largest = metric.scale.iter().fold(0.0, |a: f64, b| a.max(*b));
        let unit = if largest > 0.0 { largest } else { 1.0 };
        let relative = Metric { kind: metric.kind, scale: metric.scale.map(|scale| scale / unit) };
        let frame = Frame::new(&features, metric.kind);
        let numbers = episodes.iter().map(|(number, _)| *number).collect();
        let experts = Experts { features, numbers, bounds, metric, relative, unit, tiles, frame };
        Self { experts, codes: None, views: views.to_vec(), levels: OnceCell::new() }
    }

    fn levels(&self) -> &[[Level; 3]] {
        let experts = &self.experts;
        self.levels.get_or_init(|| {
            let all = (0, experts.features.count());
            let framed = [0, 1, 2].map(|modality| experts.frame.apply(&experts.features, modality, all));
            let level = |view: &View| {
                let [o, m, a] = [0, 1, 2].map(|i| Level::new(&framed[i], *view, (&experts.relative, i)));
                Some([o?, m?, a?])
            };
            self.views.iter().filter_map(level).collect()
        })
    }

    /// Improves `matches`, one per query, by the nearest of these segments, leaving out the episode
    /// number `without`. What was there stays where none is nearer; a tie goes to the lowest
    /// episode number, then the first step.
    pub fn improve(&self, queries: &Features, without: Option<u32>, matches: &mut [Option<Match>]) {
        let threads = usize::try_from(tch::get_num_threads()).unwrap_or(1);
        let worth = queries.count() * self.experts.features.count() / PAIRS_A_THREAD;
        let threads = threads.min(worth).max(1);
        let left = match &self.codes {
            Some(codes) => self.scan(codes, (queries, threads), without, matches),
            None => (0..queries.count()).collect(),
        };
        if !left.is_empty() {
            self.sweep(&left, (queries, threads), without, matches);
        }
    }

    /// Looks at all queries through `codes`; the numbers of those that are yet to be looked at.
    fn scan(
        &self,
        codes: &Codes,
        (queries, threads): (&Features, usize),
        without: Option<u32>,
        matches: &mut [Option<Match>],
    ) -> Vec<usize> {
        let blocks = Mutex::new(matches.chunks_mut(scan::BLOCK).enumerate());
        let left = Mutex::new(Vec::new());
        let without = self.experts.left_out(without);
        let scans = std::iter::repeat_with(|| Scan::new(&self.experts, codes, queries, without));
        device::side_by_side(scans.take(threads).collect(), |mut scan| {
            let mut own = Vec::new();
            // A thread that failed cannot have left the list half taken from.
            let next = || blocks.lock().unwrap_or_else(PoisonError::into_inner).next();
            while let Some((block, best)) = next() {
                scan.block(block * scan::BLOCK, best, &mut own);
            }
            left.lock().unwrap_or_else(PoisonError::into_inner).append(&mut own);
        });
        let mut left = left.into_inner().unwrap_or_else(PoisonError::into_inner);
        left.sort_unstable();
        left
    }

    /// Looks at the queries numbered `rows`, in rising order.
    fn sweep(
        &self,
        rows: &[usize],
        (queries, threads): (&Features, usize),
        without: Option<u32>,
        matches: &mut [Option<Match>],
    ) {
        let ranges = self.experts.ranges(without);
        let size = self.experts.tiles.queries_of(self.experts.features.count());
        let blocks = Mutex::new(matches.chunks_mut(size).enumerate());
        let sweeps: Vec<Sweep<'_>> =
            (0..threads).map(|_| Sweep::new(&self.experts, self.levels(), (queries, size), &ranges)).collect();
        device::side_by_side(sweeps, |mut sweep| {
            let next = || blocks.lock().unwrap_or_else(PoisonError::into_inner).next();
            while let Some((block, best)) = next() {
                sweep.block(block * size, rows, best);
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
    /// The segments of episode number `without`: (from, to).
    fn left_out(&self, without: Option<u32>) -> (usize, usize) {
        let skipped = without.and_then(|number| self.numbers.binary_search(&number).ok());
        let all = self.features.count();
        skipped.map_or((all, all), |at| (self.bounds[at], self.bounds[at + 1]))
    }

    /// Tiles over all segments but those of episode number `without`: (from, to).
    fn ranges(&self, without: Option<u32>) -> Vec<(usize, usize)> {
        let all = self.features.count();
        let (start, end) = self.left_out(without);
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
