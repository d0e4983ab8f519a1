//! One thread's pass over the tiles: bounds, and a direct comparison of whatever the bounds cannot
//! rule out.

use tch::{Device, Kind, Tensor};

use crate::bound::{Framed, limit};
use crate::corpus::Corpus;
use crate::level::{GROUP, Level, Placed};
use crate::matched::Match;
use crate::points::Points;
use crate::slide::{Bounds, Slide};
use crate::tensor::int;

/// With more candidates than this in a row of a tile, a full product costs less than comparing them.
const CANDIDATES: usize = 32;
/// Number of rows of tiles after which the benefit of a level is judged.
const TRIAL: usize = 1024;

/// What the bounds of a tile come from.
pub(crate) enum Filter {
    /// The cheaper levels first; the last one rules out all points that products can rule out.
    Levels(Vec<[Level; 3]>),
    /// Windows of rows.
    Slides([Slide; 3]),
}

impl Filter {
    /// A copy for another thread.
    fn share(&self) -> Self {
        match self {
            Self::Levels(levels) => {
                Self::Levels(levels.iter().map(|level| level.each_ref().map(Level::share)).collect())
            }
            Self::Slides(slides) => Self::Slides(slides.each_ref().map(Slide::share)),
        }
    }

    pub(crate) fn levels(&self) -> &[[Level; 3]] {
        match self {
            Self::Levels(levels) => levels,
            Self::Slides(_) => &[],
        }
    }
}

/// State of one thread.
pub(crate) struct Sweep<'a> {
    corpus: &'a Corpus,
    filter: Filter,
    queries: &'a Points,
    ranges: &'a [(usize, usize)],
    /// Buffer of a tile's products.
    buffer: Tensor,
    /// The lower bounds of a tile, `[rows, GROUP, groups]` in sequence, for the library.
    sum: Tensor,
    /// The same for this module.
    bounds: Bounds,
    /// Per level, the rows of tiles that it processed, and those that it could not settle.
    tried: Vec<usize>,
    failed: Vec<usize>,
}

/// A block of queries on one level.
struct Block {
    placed: [Placed; 3],
    /// Per part, upper bound of the summed displacement of queries and points.
    moved: [f64; 3],
}

/// A row's lower bounds to the points from `from` to `to`.
struct Row<'a> {
    from: usize,
    to: usize,
    /// Group g holds the bounds at g, g + groups, g + 2 groups, …
    bounds: &'a [f32],
    /// The smallest bound of each group.
    lows: &'a [f32],
}

impl<'a> Sweep<'a> {
    /// Blocks have at most `rows` queries.
    pub(crate) fn new(
        corpus: &'a Corpus,
        filter: &Filter,
        (queries, rows): (&'a Points, usize),
        ranges: &'a [(usize, usize)],
    ) -> Self {
        let widest = ranges.iter().map(|(from, to)| to - from).max().unwrap_or(0);
        let levels = filter.levels().len();
        let size = if levels > 0 { rows.min(queries.count()) * widest.next_multiple_of(GROUP) } else { 0 };
        let zeros = || Tensor::zeros([int(size)], (Kind::Float, Device::Cpu));
        Self {
            corpus,
            filter: filter.share(),
            queries,
            ranges,
            buffer: zeros(),
            sum: zeros(),
            bounds: Bounds::of_size(size),
            tried: vec![0; levels],
            failed: vec![0; levels],
        }
    }

    /// Improves `best` for the queries numbered `rows`, starting at `begin`.
    pub(crate) fn block(&mut self, begin: usize, rows: &[usize], best: &mut [Option<Match>]) {
        let rows = &rows[rows.partition_point(|row| *row < begin)..];
        let rows = &rows[..rows.partition_point(|row| *row < begin + best.len())];
        if rows.is_empty() {
            return;
        }
        let corpus = self.corpus;
        if let Filter::Slides(slides) = &self.filter {
            let (queries, block) = (self.queries, (begin, begin + best.len()));
            let placed = slides.each_ref().map(|slide| slide.place(corpus, queries, block));
            let moved = std::array::from_fn(|i| slides[i].moved + placed[i].moved);
            for range in self.ranges {
                let mut open: Vec<usize> = rows.iter().map(|row| row - begin).collect();
                self.bounds.fill(corpus, slides, (queries, &placed, block), (&open, *range));
                self.settle((begin, moved, usize::MAX), *range, &mut open, best);
            }
            return;
        }
        let framed: [Framed; 3] =
            std::array::from_fn(|i| corpus.frame.apply(self.queries, i, begin..begin + best.len()));
        let mut blocks: Vec<Option<Block>> = self.filter.levels().iter().map(|_| None).collect();
        for range in self.ranges {
            let mut open: Vec<usize> = rows.iter().map(|row| row - begin).collect();
            for (level, block) in blocks.iter_mut().enumerate().skip(self.first_level()) {
                let block = block.get_or_insert_with(|| place(&self.filter.levels()[level], &framed));
                self.bound((level, block), *range, (&open, best.len()));
                let last = level + 1 == self.filter.levels().len();
                let most = if last { usize::MAX } else { CANDIDATES };
                self.tried[level] += open.len();
                self.settle((begin, block.moved, most), *range, &mut open, best);
                self.failed[level] += open.len();
                if open.is_empty() {
                    break;
                }
            }
        }
    }

    /// The first level to use: one that does not leave most rows to the next.
    fn first_level(&self) -> usize {
        let pays = |level: &usize| self.tried[*level] < TRIAL || self.failed[*level] * 2 < self.tried[*level];
        let last = self.filter.levels().len() - 1;
        (0..last).find(pays).unwrap_or(last)
    }

    /// Fills `bounds` and `lows` with the lower bounds of the `open` of `all` rows to the points `from..to`, and
    /// to a few more that fill the last group.
    fn bound(&mut self, (level, block): (usize, &Block), (from, to): (usize, usize), (open, all): (&[usize], usize)) {
        let (width, count) = ((to - from).next_multiple_of(GROUP), open.len());
        let mut sum = self.sum.narrow(0, 0, int(count * width)).view([int(count), int(width)]);
        let some = (count < all).then(|| {
            let open: Vec<i64> = open.iter().map(|row| int(*row)).collect();
            Tensor::from_slice(&open)
        });
        let mut first = true;
        for (level, placed) in self.filter.levels()[level].iter().zip(&block.placed).filter(|(level, _)| level.counts())
        {
            level.bound((placed, some.as_ref()), (self.corpus, from), (&mut sum, first), &self.buffer);
            first = false;
        }
        if first {
            let _ = sum.zero_();
        }
        let lows = sum.view([int(count), int(GROUP), -1]).amin([1i64].as_slice(), false);
        lows.copy_data(&mut self.bounds.lows, count * width / GROUP);
        sum.copy_data(&mut self.bounds.all, count * width);
    }

    /// Keeps in `open` the rows for which the bounds leave more than `most` candidates; improves `best` of the others.
    fn settle(
        &self,
        (begin, moved, most): (usize, [f64; 3], usize),
        (from, to): (usize, usize),
        open: &mut Vec<usize>,
        best: &mut [Option<Match>],
    ) {
        let width = (to - from).next_multiple_of(GROUP);
        let mut rows = self.bounds.all.chunks_exact(width).zip(self.bounds.lows.chunks_exact(width / GROUP));
        open.retain(|row| {
            rows.next().is_some_and(|(bounds, lows)| {
                let bounds = Row { from, to, bounds, lows };
                !self.refine((begin + row, moved), &bounds, most, &mut best[*row])
            })
        });
    }

    /// Compares query `at` directly with the points that `row` cannot rule out; false if there are more than `most`.
    fn refine(&self, (at, moved): (usize, [f64; 3]), row: &Row<'_>, most: usize, best: &mut Option<Match>) -> bool {
        let corpus = self.corpus;
        let allowed = |best: &Option<Match>| {
            best.as_ref().map_or(f32::INFINITY, |best| limit(&corpus.relative, moved, best.distance / corpus.unit))
        };
        let mut most_allowed = allowed(best);
        if row.lows.iter().all(|low| *low > most_allowed) {
            return true;
        }
        let mut consider = |place: usize| {
            let found = corpus.compare((self.queries, at), place);
            if found.beats(best) {
                *best = Some(found);
            }
            allowed(best)
        };
        // The likeliest winner first: its distance rules out nearly all the others.
        let likeliest = row.likeliest();
        if let Some(likeliest) = likeliest {
            most_allowed = most_allowed.min(consider(likeliest));
        }
        if row.candidates(most_allowed).nth(most).is_some() {
            return false;
        }
        // In order of the points, skipping those that the last comparison ruled out.
        for (place, bound) in row.candidates(most_allowed) {
            if bound <= most_allowed && Some(place) != likeliest {
                most_allowed = consider(place);
            }
        }
        true
    }
}

impl Row<'_> {
    /// The point with the smallest bound.
    fn likeliest(&self) -> Option<usize> {
        let lowest = self.lows.iter().copied().fold(f32::INFINITY, f32::min);
        self.candidates(lowest).next().map(|(place, _)| place)
    }

    /// The points, and their bounds, that are not ruled out when bounds above `allowed` are.
    fn candidates(&self, allowed: f32) -> impl Iterator<Item = (usize, f32)> {
        let groups = self.lows.len();
        let open = self.lows.iter().enumerate().filter(move |(_, low)| **low <= allowed).map(|(group, _)| group);
        let members = open.flat_map(move |group| (group..self.bounds.len()).step_by(groups));
        let bounds = members.map(|offset| (self.from + offset, self.bounds[offset]));
        bounds.filter(move |(place, bound)| *bound <= allowed && *place < self.to)
    }
}

fn place(level: &[Level; 3], framed: &[Framed; 3]) -> Block {
    let placed: [Placed; 3] = std::array::from_fn(|i| level[i].place(&framed[i]));
    let moved = std::array::from_fn(|i| placed[i].moved + level[i].moved);
    Block { placed, moved }
}
