//! One thread's pass over the codes of points: bounds, and a direct comparison of the few that they
//! cannot rule out. Leaves queries for which those are many.

use crate::bound::limit;
use crate::codes::{Codes, Queries};
use crate::corpus::Corpus;
use crate::lanes::{self, Lanes, PANELS, QUERIES, WIDE};
use crate::matched::Match;
use crate::points::Points;

/// Queries that stay in the cache while points pass.
pub(crate) const BLOCK: usize = 256;
/// With more candidates than this, a finer filter costs less than comparing them.
const CANDIDATES: usize = 64;
/// Number of queries after which the benefit of codes is judged.
const TRIAL: usize = 512;

/// State of one thread.
pub(crate) struct Scan<'a> {
    corpus: &'a Corpus,
    codes: &'a Codes,
    features: &'a Points,
    /// Excluded points: (from, to).
    without: (usize, usize),
    queries: Queries,
    /// States of a block's queries.
    states: Vec<State>,
    /// Queries processed, and queries left to the next filter.
    tried: usize,
    failed: usize,
}

/// State of one query.
#[derive(Default)]
struct State {
    /// Points with a larger bound are ruled out.
    limit: f32,
    /// The smallest bound so far.
    least: f32,
    /// Points, with their bounds, that are still to be compared.
    candidates: Vec<(usize, f32)>,
    left: bool,
}

impl<'a> Scan<'a> {
    pub(crate) fn new(corpus: &'a Corpus, codes: &'a Codes, features: &'a Points, without: (usize, usize)) -> Self {
        let states = std::iter::repeat_with(State::default).take(BLOCK).collect();
        Self { corpus, codes, features, without, queries: Queries::new(), states, tried: 0, failed: 0 }
    }

    /// Improves `best`, of at most [`BLOCK`] queries starting at `begin`; adds to `left` those that need the next
    /// filter.
    pub(crate) fn block(&mut self, begin: usize, best: &mut [Option<Match>], left: &mut Vec<usize>) {
        if self.tried >= TRIAL && self.failed * 2 > self.tried {
            left.extend(begin..begin + best.len());
            return;
        }
        self.queries.fill((self.codes, &self.corpus.frame), self.features, (begin, begin + best.len()));
        for (at, best) in best.iter().enumerate() {
            let limit = self.limit(at, best);
            let state = &mut self.states[at];
            (state.limit, state.least, state.left) = (limit, f32::INFINITY, false);
            state.candidates.clear();
        }
        for from in (0..self.codes.panels()).step_by(PANELS) {
            let to = (from + PANELS).min(self.codes.panels());
            if !(self.without.0 <= from * WIDE && to * WIDE <= self.without.1) {
                self.tile(begin, (from, to), best);
            }
        }
        self.tried += best.len();
        for (at, best) in best.iter_mut().enumerate() {
            let candidates = std::mem::take(&mut self.states[at].candidates);
            for (place, bound) in &candidates {
                if *bound <= self.states[at].limit {
                    self.compare((begin, at), *place, best);
                }
            }
            self.states[at].candidates = candidates;
            if self.states[at].left {
                self.failed += 1;
                left.push(begin + at);
            }
        }
    }

    /// All queries, starting at `begin`, and panels `from..to`.
    fn tile(&mut self, begin: usize, (from, to): (usize, usize), best: &mut [Option<Match>]) {
        let panels = self.codes.some((from, to));
        let wanted = self.wanted(from * WIDE);
        let mut bounds = [[Lanes([0f32; WIDE]); PANELS]; QUERIES];
        for first in (0..best.len()).step_by(QUERIES) {
            // The last query repeats where the block is not full.
            let query = |q: usize| {
                let at = (first + q).min(best.len() - 1);
                self.queries.get(at, self.codes, self.states[at].limit)
            };
            let open = lanes::bounds(&[query(0), query(1), query(2), query(3)], &panels, &mut bounds);
            for ((at, best), (open, bounds)) in best.iter_mut().enumerate().skip(first).zip(open.iter().zip(&bounds)) {
                if open & wanted != 0 {
                    self.consider((begin, at), (from * WIDE, open & wanted), bounds, best);
                }
            }
        }
    }

    /// One bit for each point of a tile starting at `from` that exists and is not excluded.
    fn wanted(&self, from: usize) -> u64 {
        let (until, without) = (self.corpus.points.count(), self.without);
        let segments = (from..from + PANELS * WIDE).enumerate();
        let wanted = segments.filter(|(_, place)| *place < until && !(without.0..without.1).contains(place));
        wanted.fold(0, |all, (bit, _)| all | 1 << bit)
    }

    /// Adds to the candidates of query `at` of the block those `open` points, numbered from `from`, that `bounds` do
    /// not rule out; compares likely winners at once.
    fn consider(
        &mut self,
        (begin, at): (usize, usize),
        (from, mut open): (usize, u64),
        bounds: &[Lanes<f32>; PANELS],
        best: &mut Option<Match>,
    ) {
        let bound = |bit: usize| bounds[bit / WIDE].0[bit % WIDE];
        let likeliest = bits(open).map(|bit| (bit, bound(bit))).min_by(|a, b| a.1.total_cmp(&b.1));
        if let Some((bit, bound)) = likeliest.filter(|(_, bound)| *bound < self.states[at].least) {
            self.states[at].least = bound;
            self.compare((begin, at), from + bit, best);
            open &= !(1 << bit);
        }
        let state = &mut self.states[at];
        let limit = state.limit;
        let near = bits(open).map(|bit| (from + bit, bound(bit))).filter(|(_, bound)| *bound <= limit);
        state.candidates.extend(near);
        if state.candidates.len() > CANDIDATES {
            state.candidates.retain(|(_, bound)| *bound <= limit);
        }
        if state.candidates.len() > CANDIDATES {
            state.candidates.clear();
            (state.left, state.limit) = (true, f32::NEG_INFINITY);
        }
    }

    fn compare(&mut self, (begin, at): (usize, usize), place: usize, best: &mut Option<Match>) {
        let found = self.corpus.compare((self.features, begin + at), place);
        if found.beats(best) {
            *best = Some(found);
            self.states[at].limit = self.limit(at, best);
        }
    }

    /// The largest bound of a point that may still win.
    fn limit(&self, at: usize, best: &Option<Match>) -> f32 {
        let (metric, moved) = (&self.corpus.relative, self.queries.moved[at]);
        best.as_ref().map_or(f32::INFINITY, |best| limit(metric, moved, best.distance / self.corpus.unit))
    }
}

/// The set bits of `all`.
fn bits(mut all: u64) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let bit = all.trailing_zeros();
        all &= all.wrapping_sub(1);
        (bit < u64::BITS).then_some(bit as usize)
    })
}
