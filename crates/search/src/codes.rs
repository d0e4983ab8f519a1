//! Points as byte codes: every value as one of 255 multiples of a step. Products of codes are
//! exact, and four times as fast where the processor has an instruction for them; a distance
//! changes by no more than rounding to steps moved the two points. Independent of the search.

use crate::bound::{Frame, U, UNDERFLOW, factor};
use crate::lanes::{self, CODES, Lanes, MOST, Panels, Query, Terms, WIDE};
use crate::metric::Metric;
use crate::points::Points;

/// Wider rows could overflow the sums of codes' products, of 255 × 127 each at most.
const MOST_WIDE: usize = 1 << 15;
/// At most this many codes, and their squares, add up exactly in single precision: 127² × 1024 < 2²⁴.
const EXACT: usize = 1024;
/// The smallest step with a finite inverse.
const LEAST_STEP: f32 = 1e-32;
/// A square that keeps the padding of the last panel far from every query, with a finite root.
const FAR: f32 = 1e30;
/// Upper bound of the error of a value divided by its step: three roundings of at most 127.
const DIVISION: f64 = 3e-5;
/// Upper bound of the errors of a square and its rounding, of the sum of two squares, and of the product, its rounding
/// and addition.
const ROUNDING: f64 = 16.0 * U;

/// Points' codes.
pub(crate) struct Codes {
    sides: [Side; 3],
    /// Per panel of sixteen points, part and group of four codes: those codes of each point, as unsigned bytes (plus
    /// 128).
    panels: Vec<Lanes<i32>>,
    /// Per panel and part: the points' squares.
    squares: Vec<Lanes<f32>>,
    /// Number of groups of four codes, per part.
    groups: [usize; 3],
    /// Number of groups in all parts.
    all: usize,
    roots: bool,
}

/// One part.
struct Side {
    step: f32,
    /// Factor of squared distances.
    factor: f64,
    /// Longest distance by which rounding moved a point.
    moved: f64,
    /// The square root of the number of values.
    root: f64,
}

/// Queries' codes.
pub(crate) struct Queries {
    codes: Vec<i32>,
    terms: Vec<[Terms; 3]>,
    /// Per query and part, upper bound of the summed displacement of query and points.
    pub(crate) moved: Vec<[f64; 3]>,
    scratch: Scratch,
}

/// Buffers for bringing a row into the frame.
#[derive(Default)]
pub(crate) struct Scratch {
    unit: Vec<f32>,
    placed: [Vec<Lanes<f32>>; 3],
}

impl Scratch {
    /// Row `at` of `part`, in the frame, and the magnitude of its largest value.
    fn place(&mut self, frame: &Frame, features: &Points, (part, at): (usize, usize)) -> f32 {
        let centre = frame.lanes(part);
        let placed = &mut self.placed[part];
        placed.resize(centre.len(), Lanes([0.0; WIDE]));
        let row = frame.row(features, (part, at), &mut self.unit);
        lanes::centre(row, centre, placed)
    }

    /// Writes codes of the last placed row of `part` to `codes`.
    fn code(&self, part: usize, grid: Grid, codes: &mut [i32]) -> Sums {
        let mut sums = Sums::default();
        for (placed, codes) in self.placed[part].chunks(EXACT / WIDE).zip(codes.chunks_mut(EXACT / CODES)) {
            sums.add(lanes::code(placed, grid.inverse, codes));
        }
        sums
    }
}

/// The sums of [`lanes::Sums`] over a row of any width.
#[derive(Clone, Copy, Default)]
struct Sums {
    codes: f64,
    squares: f64,
    rests: f64,
}

impl Sums {
    fn add(&mut self, some: lanes::Sums) {
        self.codes += f64::from(some.codes);
        self.squares += f64::from(some.squares);
        self.rests += f64::from(some.rests);
    }
}

/// The step of rounding.
#[derive(Clone, Copy)]
struct Grid {
    step: f32,
    inverse: f32,
}

impl Grid {
    /// The grid of values with magnitudes of at most `largest`.
    fn new(largest: f32) -> Self {
        Self { step: (largest / MOST).max(LEAST_STEP), inverse: (MOST / largest).min(1.0 / LEAST_STEP) }
    }
}

/// A lower bound of `square` for any rounding and addition, also below the range of single precision.
fn below(square: f64) -> f32 {
    #[expect(clippy::cast_possible_truncation, reason = "the rounding is in the margin")]
    let square = (square * (1.0 - ROUNDING) - UNDERFLOW) as f32;
    square
}

impl Codes {
    /// The codes of all `corpus` points; `None` if codes are not possible, or not faster.
    pub(crate) fn new(corpus: &Points, frame: &Frame, metric: &Metric) -> Option<Self> {
        if !lanes::fast() || corpus.count() == 0 || corpus.widths().iter().any(|width| *width > MOST_WIDE) {
            return None;
        }
        let groups = corpus.widths().map(|width| width.div_ceil(WIDE) * (WIDE / CODES));
        let (all, panels) = (groups.iter().sum(), corpus.count().div_ceil(WIDE));
        let mut codes = Self {
            sides: [0, 1, 2].map(|i| Side::new(factor(metric, i, 1.0), corpus.widths()[i])),
            panels: vec![Lanes([0; WIDE]); panels * all],
            squares: vec![Lanes([FAR; WIDE]); panels * 3],
            groups,
            all,
            roots: metric.kind == crate::metric::Distance::Euclidean,
        };
        for part in 0..3 {
            codes.fill(corpus, frame, part);
        }
        Some(codes)
    }

    fn fill(&mut self, corpus: &Points, frame: &Frame, part: usize) {
        let mut scratch = Scratch::default();
        let largest = (0..corpus.count()).map(|at| scratch.place(frame, corpus, (part, at))).fold(0.0, f32::max);
        let (all, from) = (self.all, self.groups[..part].iter().sum::<usize>());
        let side = &mut self.sides[part];
        let grid = Grid::new(largest);
        side.step = grid.step;
        let scale = side.factor * f64::from(side.step).powi(2);
        let mut row = vec![0i32; self.groups[part]];
        for at in 0..corpus.count() {
            scratch.place(frame, corpus, (part, at));
            let sums = scratch.code(part, grid, &mut row);
            side.moved = side.moved.max(side.moved(frame, (largest, grid), &sums));
            let (panel, lane) = (at / WIDE, at % WIDE);
            self.squares[panel * 3 + part].0[lane] = below(scale * sums.squares);
            for (to, code) in self.panels[panel * all + from..].iter_mut().zip(&row) {
                // Adds 128 to each of the four bytes.
                to.0[lane] = code ^ i32::from_ne_bytes([0x80; 4]);
            }
        }
    }

    pub(crate) fn panels(&self) -> usize {
        self.squares.len() / 3
    }

    /// Panels `from..to`.
    pub(crate) fn some(&self, (from, to): (usize, usize)) -> Panels<'_> {
        Panels {
            codes: &self.panels[from * self.all..to * self.all],
            squares: &self.squares[from * 3..to * 3],
            groups: self.groups,
            all: self.all,
            count: to - from,
            roots: self.roots,
        }
    }
}

impl Queries {
    pub(crate) fn new() -> Self {
        Self { codes: Vec::new(), terms: Vec::new(), moved: Vec::new(), scratch: Scratch::default() }
    }

    /// Replaces the content by rows `from..to` of `features`.
    pub(crate) fn fill(&mut self, (codes, frame): (&Codes, &Frame), features: &Points, (from, to): (usize, usize)) {
        self.codes.resize((to - from) * codes.all, 0);
        self.terms.resize(to - from, [Terms::default(); 3]);
        self.moved.resize(to - from, [0.0; 3]);
        let rows = self.codes.chunks_exact_mut(codes.all).zip(&mut self.terms).zip(&mut self.moved);
        for (at, ((mut place, terms), moved)) in (from..to).zip(rows) {
            // The loops over the parts are interleaved, so that none waits for the result of another.
            let mut largest = [0f32; 3];
            for (part, largest) in largest.iter_mut().enumerate() {
                *largest = self.scratch.place(frame, features, (part, at));
            }
            let grids = largest.map(Grid::new);
            let mut sums = [Sums::default(); 3];
            for (part, sums) in sums.iter_mut().enumerate() {
                let (of_part, rest) = place.split_at_mut(codes.groups[part]);
                *sums = self.scratch.code(part, grids[part], of_part);
                place = rest;
            }
            for (i, side) in codes.sides.iter().enumerate() {
                terms[i] = side.terms(grids[i].step, &sums[i]);
                moved[i] = side.moved(frame, (largest[i], grids[i]), &sums[i]) + side.moved;
            }
        }
    }

    pub(crate) fn get(&self, at: usize, codes: &Codes, limit: f32) -> Query<'_> {
        Query { codes: &self.codes[at * codes.all..][..codes.all], terms: &self.terms[at], limit }
    }
}

impl Side {
    /// Upper bound of the distance of a row with `sums` from its exact position, in steps of `grid`, for values of at
    /// most `largest`.
    fn moved(&self, frame: &Frame, (largest, grid): (f32, Grid), sums: &Sums) -> f64 {
        let rests = sums.rests.sqrt() * 1.001 + DIVISION * self.root;
        frame.moved(f64::from(largest) * self.root * 1.001) + f64::from(grid.step) * rests
    }

    fn new(factor: f64, width: usize) -> Self {
        #[expect(clippy::cast_precision_loss, reason = "a feature's width is small")]
        let root = (width as f64).sqrt();
        Self { step: 0.0, factor, moved: 0.0, root }
    }

    /// The terms of a query with `sums` in steps of `step`.
    fn terms(&self, step: f32, sums: &Sums) -> Terms {
        let own = f64::from(step);
        #[expect(clippy::cast_possible_truncation, reason = "whole and small, or the rounding is in the margin")]
        let (begin, factor) = ((-128.0 * sums.codes) as i32, (-2.0 * self.factor * own * f64::from(self.step)) as f32);
        Terms { begin, factor, square: below(self.factor * own * own * sums.squares) }
    }
}
