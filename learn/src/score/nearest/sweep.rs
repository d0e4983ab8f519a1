//! One thread's way over the tiles: products, bounds, and a direct comparison of whatever the
//! bounds cannot rule out.

use tch::{Device, Kind, Tensor};

use super::bound::{Framed, add, limit, reach};
use super::{Experts, Match};
use crate::batch::{int, rows};
use crate::score::features::Features;

/// Bounds looked through at once.
const LOOK: usize = 16;
/// More candidates than this in a row of a tile, and a full product costs less than comparing them.
const CANDIDATES: usize = 24;
/// Rows of tiles after which to judge whether the first level pays.
const TRIAL: usize = 1024;

/// What one thread works with.
pub(super) struct Sweep<'a> {
    experts: &'a Experts,
    /// Per level.
    doubled: Vec<[Tensor; 3]>,
    queries: &'a Features,
    ranges: &'a [(usize, usize)],
    /// The products of a tile, as the library writes them and as we read them.
    product: Tensor,
    products: Vec<f32>,
    /// The lower bounds of a tile.
    bounds: Vec<f32>,
    /// Rows of tiles that the first level has seen, and those it could not settle.
    tried: usize,
    failed: usize,
}

/// A block of queries on one level.
struct Block {
    /// `[count, d]` per modality.
    rows: [Tensor; 3],
    squares: [Vec<f32>; 3],
    /// How far the distances of each query may have been changed.
    reach: Vec<f64>,
}

impl<'a> Sweep<'a> {
    pub(super) fn new(
        experts: &'a Experts,
        doubled: &[[Tensor; 3]],
        queries: &'a Features,
        ranges: &'a [(usize, usize)],
    ) -> Self {
        let size = experts.tiles.queries.min(queries.count()) * experts.tiles.experts.min(experts.features.count());
        Self {
            experts,
            doubled: doubled.iter().map(|level| level.each_ref().map(Tensor::shallow_clone)).collect(),
            queries,
            ranges,
            product: Tensor::zeros([int(size)], (Kind::Float, Device::Cpu)),
            products: vec![0.0; size],
            bounds: vec![0.0; size],
            tried: 0,
            failed: 0,
        }
    }

    /// Improves `best`, of the queries that begin at `begin`.
    pub(super) fn block(&mut self, begin: usize, best: &mut [Option<Match>]) {
        let experts = self.experts;
        let framed: [Framed; 3] =
            std::array::from_fn(|i| experts.frame.apply(self.queries, i, (begin, begin + best.len())));
        let mut blocks: Vec<Option<Block>> = experts.levels.iter().map(|_| None).collect();
        for range in self.ranges {
            let mut open: Vec<usize> = (0..best.len()).collect();
            for (level, block) in blocks.iter_mut().enumerate().skip(self.first_level()) {
                let block = block.get_or_insert_with(|| self.place(level, &framed));
                self.bound((level, block), *range, &open);
                let last = level + 1 == experts.levels.len();
                let most = if last { usize::MAX } else { CANDIDATES };
                self.tried += if last { 0 } else { open.len() };
                self.settle((begin, block, most), *range, &mut open, best);
                self.failed += open.len();
                if open.is_empty() {
                    break;
                }
            }
        }
    }

    /// The level to begin with: not the first if it leaves most rows to the next.
    fn first_level(&self) -> usize {
        let pays = self.tried < TRIAL || self.failed * 2 < self.tried;
        if pays { 0 } else { self.experts.levels.len() - 1 }
    }

    fn place(&self, level: usize, framed: &[Framed; 3]) -> Block {
        let level = &self.experts.levels[level];
        let count = framed[0].squares.len();
        let projected = level.directions.as_ref().map(|directions| {
            let project = |i: usize| directions[i].apply(&framed[i]);
            [0, 1, 2].map(project)
        });
        let placed = projected.as_ref().unwrap_or(framed);
        let moved = |row: usize| std::array::from_fn(|i| placed[i].moved[row] + level.moved[i]);
        Block {
            rows: placed.each_ref().map(|framed| rows(&framed.rows, framed.width, Device::Cpu)),
            reach: (0..count).map(|row| reach(&self.experts.metric, moved(row))).collect(),
            squares: placed.each_ref().map(Framed::shrunk),
        }
    }

    /// Fills `bounds` with the lower bounds of the `open` rows to the segments `from..to`.
    fn bound(&mut self, (level, block): (usize, &Block), (from, to): (usize, usize), open: &[usize]) {
        let (width, count) = (to - from, open.len());
        let (kind, factors) = (self.experts.metric.kind, self.experts.levels[level].factors);
        self.bounds[..count * width].fill(0.0);
        let product = self.product.narrow(0, 0, int(count * width)).view([int(count), int(width)]);
        let some = (count < block.reach.len()).then(|| {
            let open: Vec<i64> = open.iter().map(|row| int(*row)).collect();
            Tensor::from_slice(&open)
        });
        for modality in (0..3).filter(|i| factors[*i] > 0.0) {
            let tile = self.doubled[level][modality].narrow(0, int(from), int(width)).tr();
            let all = &block.rows[modality];
            let _ = match &some {
                Some(open) => all.index_select(0, open).mm_out(&product, &tile),
                None => all.mm_out(&product, &tile),
            };
            product.copy_data(&mut self.products, count * width);
            let squares = &self.experts.levels[level].squares[modality][from..to];
            let rows = self.bounds.chunks_exact_mut(width).zip(self.products.chunks_exact(width));
            for ((bounds, products), row) in rows.zip(open) {
                let square = block.squares[modality][*row];
                add((kind, factors[modality]), (products, squares, square), bounds);
            }
        }
    }

    /// Leaves in `open` the rows for which the bounds leave more than `most` candidates; improves
    /// the others' `best`.
    fn settle(
        &self,
        (begin, block, most): (usize, &Block, usize),
        (from, to): (usize, usize),
        open: &mut Vec<usize>,
        best: &mut [Option<Match>],
    ) {
        let mut bounds = self.bounds.chunks_exact(to - from);
        open.retain(|row| {
            let query = (begin + row, block.reach[*row]);
            bounds.next().is_some_and(|bounds| !self.refine(query, (from, bounds), most, &mut best[*row]))
        });
    }

    /// Compares query `at` directly with whatever segments from `begin` on `bounds` cannot rule
    /// out; false if those are more than `most`.
    fn refine(
        &self,
        (at, reach): (usize, f64),
        (begin, bounds): (usize, &[f32]),
        most: usize,
        best: &mut Option<Match>,
    ) -> bool {
        let allowed = |best: &Option<Match>| best.as_ref().map_or(f32::INFINITY, |best| limit(best.distance, reach));
        let lowest = lowest(bounds);
        if lowest > allowed(best) {
            return true;
        }
        let mut consider = |place: usize| {
            let found = self.experts.compare((self.queries, at), begin + place);
            if found.beats(best) {
                *best = Some(found);
            }
            allowed(best)
        };
        // The likeliest winner first: its distance rules out nearly all the others.
        let likeliest = bounds.iter().position(|bound| *bound == lowest).unwrap_or(0);
        let mut allowed = consider(likeliest);
        if most < bounds.len() && bounds.iter().filter(|bound| **bound <= allowed).count() > most {
            return false;
        }
        for (chunk, bounds) in bounds.chunks(LOOK).enumerate() {
            if !bounds.iter().fold(false, |any, bound| any | (*bound <= allowed)) {
                continue;
            }
            for (offset, bound) in bounds.iter().enumerate() {
                if *bound <= allowed {
                    allowed = consider(chunk * LOOK + offset);
                }
            }
        }
        true
    }
}

/// The smallest of `bounds`.
fn lowest(bounds: &[f32]) -> f32 {
    let smaller = |a: f32, b: f32| if b < a { b } else { a };
    let (chunks, rest) = bounds.as_chunks::<LOOK>();
    let mut lanes = [f32::INFINITY; LOOK];
    for chunk in chunks {
        for lane in 0..LOOK {
            lanes[lane] = smaller(lanes[lane], chunk[lane]);
        }
    }
    lanes.iter().chain(rest).copied().fold(f32::INFINITY, smaller)
}
