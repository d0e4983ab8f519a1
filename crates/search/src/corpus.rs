//! The points of an index: the rows of each group, tiles over them, and the direct comparison with one point. Must not
//! depend on the filters.

use crate::bound::Frame;
use crate::matched::Match;
use crate::metric::Metric;
use crate::points::Points;

/// With more points than this many times the queries of a tile, the queries' values leave the cache.
const MOST_MORE: usize = 4;

/// Sizes of the tiles that are compared; the result does not depend on them.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Tiles {
    pub(crate) queries: usize,
    pub(crate) points: usize,
}

impl Default for Tiles {
    /// A tile's products and bounds fit the cache of a core.
    fn default() -> Self {
        Self { queries: 256, points: 512 }
    }
}

impl Tiles {
    /// Number of queries to compare with `points` at a time: more for few points.
    pub(crate) fn queries_of(&self, points: usize) -> usize {
        self.queries * (self.points / points.max(1)).clamp(1, MOST_MORE)
    }
}

/// The points of an index, and the values derived from them that threads share.
pub(crate) struct Corpus {
    pub(crate) points: Points,
    /// The groups' numbers, in rising order.
    numbers: Vec<u32>,
    /// First point of each group, and the number of points as the last entry.
    bounds: Vec<usize>,
    metric: Metric,
    /// The metric with the largest scale as the unit, so that the filter stays in range.
    pub(crate) relative: Metric,
    pub(crate) unit: f64,
    pub(crate) tiles: Tiles,
    pub(crate) frame: Frame,
}

impl Corpus {
    pub(crate) fn new(groups: &[(u32, &Points)], metric: Metric, tiles: Tiles) -> Self {
        let (points, bounds) = Points::joined(groups.iter().map(|(_, points)| *points));
        let largest = metric.scale.iter().fold(0.0, |a: f64, b| a.max(*b));
        let unit = if largest > 0.0 { largest } else { 1.0 };
        let relative = Metric { kind: metric.kind, scale: metric.scale.map(|scale| scale / unit) };
        let frame = Frame::new(&points, metric.kind);
        let numbers = groups.iter().map(|(number, _)| *number).collect();
        Self { points, numbers, bounds, metric, relative, unit, tiles, frame }
    }

    /// The points of group number `without`: (from, to).
    pub(crate) fn left_out(&self, without: Option<u32>) -> (usize, usize) {
        let skipped = without.and_then(|number| self.numbers.binary_search(&number).ok());
        let all = self.points.count();
        skipped.map_or((all, all), |at| (self.bounds[at], self.bounds[at + 1]))
    }

    /// Tiles over all points except those of group number `without`: (from, to).
    pub(crate) fn ranges(&self, without: Option<u32>) -> Vec<(usize, usize)> {
        let all = self.points.count();
        let (start, end) = self.left_out(without);
        let tile = |range: (usize, usize)| {
            let begins = (range.0..range.1).step_by(self.tiles.points);
            begins.map(move |begin| (begin, range.1.min(begin + self.tiles.points)))
        };
        tile((0, start)).chain(tile((end, all))).collect()
    }

    /// The group number and the row of point `at`.
    fn place(&self, at: usize) -> (u32, u32) {
        let group = self.bounds.partition_point(|bound| *bound <= at) - 1;
        (self.numbers[group], u32::try_from(at - self.bounds[group]).unwrap_or(u32::MAX))
    }

    /// Row `query` of `queries` against point `at`, directly.
    pub(crate) fn compare(&self, queries: (&Points, usize), at: usize) -> Match {
        let parts = self.metric.parts(queries, (&self.points, at));
        let (group, row) = self.place(at);
        #[expect(clippy::cast_possible_truncation, reason = "kept in single precision")]
        let single = parts.map(|part| part as f32);
        Match { group, row, distance: self.metric.distance(parts), parts: single }
    }
}
