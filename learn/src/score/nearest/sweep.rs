//! One thread's way over the tiles: products, bounds, and a direct comparison of whatever the
//! bounds cannot rule out.

use tch::{Device, Kind, Tensor};

use super::bound::{Framed, limit};
use super::{Experts, Match};
use crate::batch::{int, rows};
use crate::score::features::Features;

/// Bounds looked through at once.
const LOOK: usize = 16;

/// What one thread works with.
pub(super) struct Sweep<'a> {
    experts: &'a Experts,
    doubled: [Tensor; 3],
    queries: &'a Features,
    ranges: &'a [(usize, usize)],
    /// The products of a tile, as the library writes them and as we read them.
    product: Tensor,
    products: Vec<f32>,
    /// The lower bounds of a tile.
    bounds: Vec<f32>,
}

/// A block of queries in the filter's frame.
struct Block {
    /// `[count, d]` per modality.
    rows: [Tensor; 3],
    squares: [Vec<f32>; 3],
    /// How far the frame may have changed the distances of each query.
    reach: Vec<f64>,
}

impl<'a> Sweep<'a> {
    pub(super) fn new(
        experts: &'a Experts,
        doubled: &[Tensor; 3],
        queries: &'a Features,
        ranges: &'a [(usize, usize)],
    ) -> Self {
        let size = experts.tiles.queries.min(queries.count()) * experts.tiles.experts.min(experts.features.count());
        Self {
            experts,
            doubled: doubled.each_ref().map(Tensor::shallow_clone),
            queries,
            ranges,
            product: Tensor::zeros([int(size)], (Kind::Float, Device::Cpu)),
            products: vec![0.0; size],
            bounds: vec![0.0; size],
        }
    }

    /// Improves `best`, of the queries that begin at `begin`.
    pub(super) fn block(&mut self, begin: usize, best: &mut [Option<Match>]) {
        let block = self.frame(begin, best.len());
        for range in self.ranges {
            self.bound(&block, *range, best.len());
            let width = range.1 - range.0;
            for (row, best) in best.iter_mut().enumerate() {
                let bounds = &self.bounds[row * width..(row + 1) * width];
                self.refine((begin + row, block.reach[row]), (range.0, bounds), best);
            }
        }
    }

    fn frame(&self, begin: usize, count: usize) -> Block {
        let experts = self.experts;
        let framed: [Framed; 3] = std::array::from_fn(|i| experts.frame.apply(self.queries, i, (begin, begin + count)));
        let moved = |row: usize| std::array::from_fn(|i| framed[i].moved[row] + experts.moved[i]);
        let widths = self.queries.widths();
        Block {
            rows: std::array::from_fn(|i| rows(&framed[i].rows, widths[i], Device::Cpu)),
            reach: (0..count).map(|row| experts.frame.reach(moved(row))).collect(),
            squares: framed.map(|framed| framed.squares),
        }
    }

    /// Fills `bounds` with the lower bounds of `count` queries to the segments `from..to`.
    fn bound(&mut self, block: &Block, (from, to): (usize, usize), count: usize) {
        let width = to - from;
        self.bounds[..count * width].fill(0.0);
        let product = self.product.narrow(0, 0, int(count * width)).view([int(count), int(width)]);
        for modality in (0..3).filter(|i| self.experts.metric.scale[*i] > 0.0) {
            let tile = self.doubled[modality].narrow(0, int(from), int(width)).tr();
            let _ = block.rows[modality].mm_out(&product, &tile);
            product.copy_data(&mut self.products, count * width);
            let squares = &self.experts.squares[modality][from..to];
            let rows = self.bounds.chunks_exact_mut(width).zip(self.products.chunks_exact(width));
            for ((bounds, products), square) in rows.zip(&block.squares[modality]) {
                self.experts.frame.add(modality, (products, squares, *square), bounds);
            }
        }
    }

    /// Compares query `at` directly with whatever segments from `begin` on `bounds` cannot rule
    /// out.
    fn refine(&self, (at, reach): (usize, f64), (begin, bounds): (usize, &[f32]), best: &mut Option<Match>) {
        let allowed = |best: &Option<Match>| best.as_ref().map_or(f32::INFINITY, |best| limit(best.distance, reach));
        let lowest = lowest(bounds);
        if lowest > allowed(best) {
            return;
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
