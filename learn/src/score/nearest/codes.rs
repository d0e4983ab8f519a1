//! Segments as byte codes: every value as one of 255 multiples of a step. Products of codes are
//! exact, and four times as fast where the processor has an instruction for them; a distance
//! changes by no more than rounding to steps moved the two segments. Knows nothing of the search.

use super::bound::{Frame, U, UNDERFLOW, factor};
use super::lanes::{self, CODES, Lanes, MOST, Panels, Query, Terms, WIDE};
use crate::score::features::Features;
use crate::score::similarity::Metric;

/// Wider rows could overflow what sums of codes' products are kept in.
const MOST_WIDE: usize = 1024;
/// So that its inverse is finite.
const LEAST_STEP: f32 = 1e-32;
/// A square so large that what fills up the last panel is never near, but its root is finite.
const FAR: f32 = 1e30;
/// More than any error of a value divided by its step: three roundings of at most 127.
const DIVISION: f64 = 3e-5;
/// A square and its rounding, the sum of two, and adding the product to it, err by less.
const ROUNDING: f64 = 16.0 * U;

/// Experts' codes.
pub(super) struct Codes {
    sides: [Side; 3],
    /// Per panel of sixteen experts, modality and four codes: those codes, 128 larger, of each.
    panels: Vec<Lanes<i32>>,
    /// Per panel and modality: the experts' squares.
    squares: Vec<Lanes<f32>>,
    /// How often four codes, per modality.
    groups: [usize; 3],
    /// In all.
    all: usize,
    roots: bool,
}

/// One modality.
struct Side {
    step: f32,
    /// What squared distances are multiplied by.
    factor: f64,
    /// The most that an expert was moved.
    moved: f64,
}

/// Queries' codes.
pub(super) struct Queries {
    codes: Vec<i32>,
    terms: Vec<[Terms; 3]>,
    /// Per modality how far query and experts may have been moved in all.
    pub(super) moved: Vec<[f64; 3]>,
    scratch: Scratch,
}

/// What a row is brought into the frame in.
#[derive(Default)]
pub(super) struct Scratch {
    unit: Vec<f32>,
    placed: Vec<Lanes<f32>>,
}

impl Scratch {
    /// Row `at` of `modality`, in the frame, and its largest value's size.
    fn place(&mut self, frame: &Frame, features: &Features, (modality, at): (usize, usize)) -> f32 {
        let centre = frame.lanes(modality);
        self.placed.resize(centre.len(), Lanes([0.0; WIDE]));
        let row = frame.row(features, (modality, at), &mut self.unit);
        lanes::centre(row, centre, &mut self.placed)
    }

    /// Codes of the row last placed, into `codes`; what is known of them, and how far from where it
    /// should be `step` times them lies.
    fn code(
        &self,
        (frame, width): (&Frame, usize),
        (largest, step): (f32, f32),
        codes: &mut [i32],
    ) -> (lanes::Sums, f64) {
        let sums = lanes::code(&self.placed, 1.0 / step, codes);
        #[expect(clippy::cast_precision_loss, reason = "a feature's width is small")]
        let root = (width as f64).sqrt();
        let rests = f64::from(sums.rests).sqrt() * 1.001 + DIVISION * root;
        (sums, frame.moved(f64::from(largest) * root * 1.001) + f64::from(step) * rests)
    }
}

fn step(largest: f32) -> f32 {
    (largest / MOST).max(LEAST_STEP)
}

/// At most `square`, however it is rounded and added; and no more wrong below single precision.
fn below(square: f64) -> f32 {
    #[expect(clippy::cast_possible_truncation, reason = "the rounding is in the margin")]
    let square = (square * (1.0 - ROUNDING) - UNDERFLOW) as f32;
    square
}

impl Codes {
    /// Of all of `experts`; `None` if that is not possible, or would not be faster.
    pub(super) fn new(experts: &Features, frame: &Frame, metric: &Metric) -> Option<Self> {
        if !lanes::fast() || experts.count() == 0 || experts.widths().iter().any(|width| *width > MOST_WIDE) {
            return None;
        }
        let groups = experts.widths().map(|width| width.div_ceil(WIDE) * (WIDE / CODES));
        let (all, panels) = (groups.iter().sum(), experts.count().div_ceil(WIDE));
        let mut codes = Self {
            sides: [0, 1, 2].map(|i| Side { step: 0.0, factor: factor(metric, i, 1.0), moved: 0.0 }),
            panels: vec![Lanes([0; WIDE]); panels * all],
            squares: vec![Lanes([FAR; WIDE]); panels * 3],
            groups,
            all,
            roots: metric.kind == crate::score::similarity::Kind::Euclidean,
        };
        for modality in 0..3 {
            codes.fill(experts, frame, modality);
        }
        Some(codes)
    }

    fn fill(&mut self, experts: &Features, frame: &Frame, modality: usize) {
        let mut scratch = Scratch::default();
        let largest = (0..experts.count()).map(|at| scratch.place(frame, experts, (modality, at))).fold(0.0, f32::max);
        let (all, from) = (self.all, self.groups[..modality].iter().sum::<usize>());
        let width = experts.widths()[modality];
        let side = &mut self.sides[modality];
        side.step = step(largest);
        let scale = side.factor * f64::from(side.step).powi(2);
        let mut row = vec![0i32; self.groups[modality]];
        for at in 0..experts.count() {
            scratch.place(frame, experts, (modality, at));
            let (sums, moved) = scratch.code((frame, width), (largest, side.step), &mut row);
            side.moved = side.moved.max(moved);
            let (panel, lane) = (at / WIDE, at % WIDE);
            self.squares[panel * 3 + modality].0[lane] = below(scale * f64::from(sums.squares));
            for (to, code) in self.panels[panel * all + from..].iter_mut().zip(&row) {
                // Adds 128 to each of the four.
                to.0[lane] = code ^ i32::from_ne_bytes([0x80; 4]);
            }
        }
    }

    pub(super) fn panels(&self) -> usize {
        self.squares.len() / 3
    }

    /// Panels `from..to`.
    pub(super) fn some(&self, (from, to): (usize, usize)) -> Panels<'_> {
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
    pub(super) fn new() -> Self {
        Self { codes: Vec::new(), terms: Vec::new(), moved: Vec::new(), scratch: Scratch::default() }
    }

    /// Rows `from..to` of `features`, in place of whatever was here.
    pub(super) fn fill(&mut self, codes: &Codes, frame: &Frame, features: &Features, (from, to): (usize, usize)) {
        let (all, count) = (codes.all, to - from);
        self.codes.resize(count * all, 0);
        self.terms.resize(count, [Terms::default(); 3]);
        self.moved.resize(count, [0.0; 3]);
        let rows = self.codes.chunks_exact_mut(all).zip(&mut self.terms).zip(&mut self.moved);
        for (at, ((mut row, terms), moved)) in (from..to).zip(rows) {
            for (modality, side) in codes.sides.iter().enumerate() {
                let largest = self.scratch.place(frame, features, (modality, at));
                let step = step(largest);
                let (of_modality, rest) = row.split_at_mut(codes.groups[modality]);
                let width = features.widths()[modality];
                let (sums, by) = self.scratch.code((frame, width), (largest, step), of_modality);
                terms[modality] = side.terms(step, &sums);
                moved[modality] = by + side.moved;
                row = rest;
            }
        }
    }

    pub(super) fn get(&self, at: usize, codes: &Codes, limit: f32) -> Query<'_> {
        Query { codes: &self.codes[at * codes.all..][..codes.all], terms: &self.terms[at], limit }
    }
}

impl Side {
    /// Of a query with `sums` in steps of `step`.
    fn terms(&self, step: f32, sums: &lanes::Sums) -> Terms {
        let own = f64::from(step);
        #[expect(clippy::cast_possible_truncation, reason = "whole and small, or the rounding is in the margin")]
        let (begin, factor) = ((-128.0 * sums.codes) as i32, (-2.0 * self.factor * own * f64::from(self.step)) as f32);
        Terms { begin, factor, square: below(self.factor * own * own * f64::from(sums.squares)) }
    }
}
