//! Exact nearest search over points.
//!
//! Products per part, ‖x − y‖² = ‖x‖² + ‖y‖² − 2 x·y after centring, are the filter: they give a lower bound of the
//! distance with a proven margin. Cheap products come first, of codes of one byte a value or along few directions, then
//! single-precision ones where those leave too many candidates; of windows of rows, those of the rows, added up.
//! Candidates that the bound cannot rule out are compared directly in double precision. So the winner and its distance
//! are exact and do not depend on tiles, threads or the processor. The product alone would not suffice: near zero, where
//! the best match is, its error exceeds the distance.

use std::cell::OnceCell;
use std::sync::{Mutex, PoisonError};

use crate::codes::Codes;
use crate::corpus::{Corpus, Tiles};
use crate::error::SearchError;
use crate::level::{Level, View};
use crate::matched::Match;
use crate::metric::{Distance, Metric};
use crate::points::Points;
use crate::scan::{self, Scan};
use crate::slide::Slide;
use crate::sweep::{Filter, Sweep};
use crate::threads;

/// Fewer pairs than this are not worth another thread.
const PAIRS_A_THREAD: usize = 1 << 17;

/// Groups of points, ready to be searched. A search uses as many threads as the tensor library.
pub struct Index {
    corpus: Corpus,
    /// The first filter, on processors with the instructions for it.
    codes: Option<Codes>,
    /// The views of the next filter, the cheaper ones first.
    views: Vec<View>,
    filter: OnceCell<Filter>,
}

impl Index {
    /// The points of `groups`, each group with its number.
    ///
    /// # Errors
    /// The numbers do not rise, or the groups differ in their shapes.
    pub fn new(groups: &[(u32, &Points)], metric: Metric) -> Result<Self, SearchError> {
        if !groups.is_sorted_by(|(a, _), (b, _)| a < b) {
            return Err(SearchError::new("groups", "must come with rising numbers, each once"));
        }
        let mut shapes = groups.iter().filter(|(_, points)| points.count() > 0).map(|(_, points)| points.shape());
        if let Some(expected) = shapes.next()
            && let Some(got) = shapes.find(|shape| *shape != expected)
        {
            return Err(SearchError::new(
                "groups",
                format!("expected {expected:?} as the first group has, got {got:?}"),
            ));
        }
        Ok(Self::with_tiles(groups, metric, Tiles::default()))
    }

    pub(crate) fn with_tiles(groups: &[(u32, &Points)], metric: Metric, tiles: Tiles) -> Self {
        let mut index = Self::with_views(groups, metric, tiles, &[View::Along, View::Whole]);
        let corpus = &index.corpus;
        index.codes = Codes::new(&corpus.points, &corpus.frame, &corpus.relative);
        if index.codes.is_some() {
            // Points that codes do not distinguish are not distinguished along few directions either.
            index.views = vec![View::Whole];
        }
        index
    }

    /// An index without codes, with those levels of `views` that pay off.
    fn with_views(groups: &[(u32, &Points)], metric: Metric, tiles: Tiles, views: &[View]) -> Self {
        let corpus = Corpus::new(groups, metric, tiles);
        Self { corpus, codes: None, views: views.to_vec(), filter: OnceCell::new() }
    }

    fn filter(&self) -> &Filter {
        let corpus = &self.corpus;
        self.filter.get_or_init(|| {
            // Vectors of unit length have no rows in common.
            if corpus.points.shape().length > 1 && corpus.relative.kind == Distance::Euclidean {
                return Filter::Slides([0, 1, 2].map(|part| Slide::new(corpus, part)));
            }
            let level = |view: &View| {
                let [o, m, a] = [0, 1, 2].map(|part| Level::new(corpus, *view, part));
                Some([o?, m?, a?])
            };
            Filter::Levels(self.views.iter().filter_map(level).collect())
        })
    }

    /// Improves `matches`, one per query, by the nearest of these points outside group number `without`. A match stays
    /// if no point is nearer; a tie goes to the lowest group number, then to the first row.
    ///
    /// # Errors
    /// The queries differ in their shape from the points, or in their number from `matches`.
    pub fn improve(
        &self,
        queries: &Points,
        without: Option<u32>,
        matches: &mut [Option<Match>],
    ) -> Result<(), SearchError> {
        self.check(queries)?;
        if matches.len() != queries.count() {
            let message = format!("expected {} (one for each query), got {}", queries.count(), matches.len());
            return Err(SearchError::new("matches", message));
        }
        let worth = queries.count() * self.corpus.points.count() / PAIRS_A_THREAD;
        let threads = threads::available().min(worth).max(1);
        let left = match &self.codes {
            Some(codes) => self.scan(codes, (queries, threads), without, matches),
            None => (0..queries.count()).collect(),
        };
        if !left.is_empty() {
            self.sweep(&left, (queries, threads), without, matches);
        }
        Ok(())
    }

    /// The nearest of these points to each query, outside group number `without`; `None` if no point is left.
    ///
    /// # Errors
    /// As [`Self::improve`].
    pub fn nearest(&self, queries: &Points, without: Option<u32>) -> Result<Option<Vec<Match>>, SearchError> {
        let mut matches = vec![None; queries.count()];
        self.improve(queries, without, &mut matches)?;
        Ok(matches.into_iter().collect())
    }

    /// Fails unless `queries` can be compared with the points.
    fn check(&self, queries: &Points) -> Result<(), SearchError> {
        let (expected, got) = (self.corpus.points.shape(), queries.shape());
        if queries.count() == 0 || self.corpus.points.count() == 0 || got == expected {
            return Ok(());
        }
        Err(SearchError::new("queries", format!("expected {expected:?} as the points have, got {got:?}")))
    }

    /// Compares all queries through `codes`; returns the numbers of the queries that remain.
    fn scan(
        &self,
        codes: &Codes,
        (queries, threads): (&Points, usize),
        without: Option<u32>,
        matches: &mut [Option<Match>],
    ) -> Vec<usize> {
        let blocks = Mutex::new(matches.chunks_mut(scan::BLOCK).enumerate());
        let left = Mutex::new(Vec::new());
        let without = self.corpus.left_out(without);
        let scans = std::iter::repeat_with(|| Scan::new(&self.corpus, codes, queries, without));
        threads::side_by_side(scans.take(threads).collect(), |mut scan| {
            let mut own = Vec::new();
            // A thread that panicked cannot have left the iterator in an inconsistent state.
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

    /// Compares the queries numbered `rows`, in rising order.
    fn sweep(
        &self,
        rows: &[usize],
        (queries, threads): (&Points, usize),
        without: Option<u32>,
        matches: &mut [Option<Match>],
    ) {
        let ranges = self.corpus.ranges(without);
        let size = self.corpus.tiles.queries_of(self.corpus.points.count());
        let blocks = Mutex::new(matches.chunks_mut(size).enumerate());
        let sweeps: Vec<Sweep<'_>> =
            (0..threads).map(|_| Sweep::new(&self.corpus, self.filter(), (queries, size), &ranges)).collect();
        threads::side_by_side(sweeps, |mut sweep| {
            let next = || blocks.lock().unwrap_or_else(PoisonError::into_inner).next();
            while let Some((block, best)) = next() {
                sweep.block(block * size, rows, best);
            }
        });
    }
}

#[cfg(test)]
mod tests;
