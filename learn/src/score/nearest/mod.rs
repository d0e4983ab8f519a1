//! Exact nearest search over every expert segment.
//!
//! A single-precision matrix product per modality, ‖x − y‖² = ‖x‖² + ‖y‖² − 2 x·y after centring,
//! is the filter: it gives a lower bound of the distance with a proven margin. Whatever the bound
//! cannot rule out is compared again directly in double precision. So the winner and its distance
//! are exact and do not depend on tiles or threads. The product itself would not do: near zero,
//! where the best match is, its error exceeds the distance.

mod bound;

use std::ops::Range;

use tch::Tensor;

use super::features::Features;
use super::similarity::LastL2;
use crate::batch::{int, values};
use bound::{Centred, centre, limit};

/// How much is compared at a time; the result does not depend on it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Tiles {
    pub(crate) queries: usize,
    pub(crate) experts: usize,
}

impl Default for Tiles {
    /// Two single-precision tiles of this size stay within a core's cache.
    fn default() -> Self {
        Self { queries: 128, experts: 2048 }
    }
}

/// A query's nearest expert segment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Match {
    /// Its place among all expert segments.
    pub(crate) expert: usize,
    /// The scaled sum of the distances.
    pub(crate) distance: f64,
    /// The distances of o, m and a.
    pub(crate) parts: [f64; 3],
}

impl Match {
    /// Nearer, or as near and earlier.
    fn beats(&self, other: &Option<Self>) -> bool {
        other.as_ref().is_none_or(|other| (self.distance, self.expert) < (other.distance, other.expert))
    }
}

/// All expert segments, ready to be compared with.
pub(crate) struct Reference {
    features: Features,
    /// Where each expert episode's segments begin, and at last where all end.
    bounds: Vec<usize>,
    similarity: LastL2,
    tiles: Tiles,
    centre: [Vec<f32>; 3],
    centred: Centred,
    /// The latest winner: a first bound for the next query.
    latest: Option<usize>,
}

impl Reference {
    /// The segments of `episodes`. Searches on the CPU, where single precision is what it says.
    pub(crate) fn new(episodes: &[Features], similarity: LastL2, tiles: Tiles) -> Self {
        let width = episodes.first().map_or(1, |features| features.width);
        let mut bounds = vec![0];
        let mut values: [Vec<f32>; 3] = Default::default();
        for features in episodes {
            bounds.push(bounds[bounds.len() - 1] + features.count());
            for (all, part) in values.iter_mut().zip(&features.values) {
                all.extend_from_slice(part);
            }
        }
        let middle: [Vec<f32>; 3] = std::array::from_fn(|i| centre(&values[i], width));
        Self {
            centred: Centred::new(values.each_ref().map(Vec::as_slice), &middle),
            features: Features { values, width },
            bounds,
            similarity,
            tiles,
            centre: middle,
            latest: None,
        }
    }

    /// The expert episode and the step of expert segment `expert`.
    pub(crate) fn place(&self, expert: usize) -> (u32, u32) {
        let episode = self.bounds.partition_point(|bound| *bound <= expert) - 1;
        let short = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
        (short(episode), short(expert - self.bounds[episode]))
    }

    /// The nearest expert segment of every query, leaving out the expert episodes `without`;
    /// `None` if that leaves no expert.
    pub(crate) fn nearest(&mut self, queries: &Features, without: &Range<usize>) -> Option<Vec<Match>> {
        let skip = self.bounds[without.start]..self.bounds[without.end];
        if skip.len() == self.features.count() {
            return None;
        }
        let mut matches = Vec::with_capacity(queries.count());
        for begin in (0..queries.count()).step_by(self.tiles.queries) {
            let end = queries.count().min(begin + self.tiles.queries);
            let found = self.search(queries, begin..end, &skip);
            self.latest = found.last().map(|found| found.expert);
            matches.extend(found);
        }
        Some(matches)
    }

    /// The nearest of queries `block`.
    fn search(&self, queries: &Features, block: Range<usize>, skip: &Range<usize>) -> Vec<Match> {
        let width = queries.width;
        let rows = block.start * width..block.end * width;
        let part = queries.values.each_ref().map(|all| &all[rows.clone()]);
        let centred = Centred::new(part, &self.centre);
        let mut best: Vec<Option<Match>> = vec![None; block.len()];
        if let Some(guess) = self.latest {
            for (offset, best) in best.iter_mut().enumerate() {
                for expert in [guess, guess + offset + 1] {
                    if expert < self.features.count() && !skip.contains(&expert) {
                        self.consider((queries, block.start + offset), expert, best);
                    }
                }
            }
        }
        let scale = &self.similarity.scale;
        for begin in (0..self.features.count()).step_by(self.tiles.experts) {
            let tile = begin..self.features.count().min(begin + self.tiles.experts);
            let bounds = centred.lower_bounds(&self.centred, scale, &tile, skip);
            let reach = centred.reach(&self.centred, scale, &tile);
            self.refine((queries, block.start), &bounds, (tile.start, &reach), &mut best);
        }
        best.into_iter().flatten().collect()
    }

    /// Compares directly whatever `bounds` cannot rule out. `tile` is its first expert and reach.
    fn refine(
        &self,
        (queries, first): (&Features, usize),
        bounds: &Tensor,
        (begin, reach): (usize, &[f64]),
        best: &mut [Option<Match>],
    ) {
        let (lowest, nearest) = bounds.min_dim(1, false);
        let lowest = values(&lowest);
        let nearest = Vec::<i64>::try_from(nearest).unwrap_or_default();
        let limit =
            |best: &Option<Match>, reach: f64| best.as_ref().map_or(f64::MAX, |best| limit(best.distance, reach));
        for (row, best) in best.iter_mut().enumerate() {
            if f64::from(lowest[row]) > limit(best, reach[row]) {
                continue;
            }
            // The likeliest winner first: its distance rules out nearly all the others.
            let query = (queries, first + row);
            let likeliest = usize::try_from(nearest[row]).unwrap_or(0);
            self.consider(query, begin + likeliest, best);
            let row_bounds = values(&bounds.get(int(row)));
            for (place, bound) in row_bounds.iter().enumerate() {
                if f64::from(*bound) <= limit(best, reach[row]) {
                    self.consider(query, begin + place, best);
                }
            }
        }
    }

    fn consider(&self, query: (&Features, usize), expert: usize, best: &mut Option<Match>) {
        let parts = LastL2::parts(query, (&self.features, expert));
        let found = Match { expert, distance: self.similarity.distance(parts), parts };
        if found.beats(best) {
            *best = Some(found);
        }
    }
}

#[cfg(test)]
mod tests;
