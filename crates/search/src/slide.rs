//! The filter for windows of rows: the product of two windows is the sum of the products of their rows, and windows that
//! overlap share those. So each row is multiplied once, not once for every window that has it. Must not depend on the
//! choice of the nearest.

use std::sync::Arc;

use multiversion::multiversion;
use tch::{Kind, Tensor};

use crate::bound::{UNDERFLOW, factor, margin, squares};
use crate::corpus::Corpus;
use crate::level::GROUP;
use crate::points::{PARTS, Points};
use crate::tensor::{int, rows};

/// One part of the points' rows.
pub(crate) struct Slide {
    part: usize,
    /// `[1, d]`: subtracted from every row; any centre is correct, a central one is fast.
    centre: Tensor,
    /// `[R, d]`: −2 × the factor × the centred rows.
    rows: Tensor,
    /// Summands of the products, one for each point.
    squares: Arc<[f32]>,
    /// Factor of squared distances.
    factor: f64,
    /// Longest distance by which centring may have moved a point.
    pub(crate) moved: f64,
}

/// One part of some queries in sequence.
pub(crate) struct Placed {
    /// `[R, d]`: the centred rows.
    rows: Tensor,
    /// Summands of the products, one for each query.
    squares: Arc<[f32]>,
    pub(crate) moved: f64,
}

/// Lower bounds of the distances of some queries to the points of a tile.
#[derive(Default)]
pub(crate) struct Bounds {
    /// Row after row, of points and of what fills their last group.
    pub(crate) all: Vec<f32>,
    /// Per row and group the smallest bound; group g has the bounds at g, g + groups, g + 2 groups, …
    pub(crate) lows: Vec<f32>,
    /// Products of rows.
    products: Vec<f32>,
    /// Sums of products.
    sums: Vec<f32>,
}

impl Slide {
    /// `part` of the points, whose distances are Euclidean.
    pub(crate) fn new(corpus: &Corpus, part: usize) -> Self {
        let (points, width) = (&corpus.points, corpus.points.shape().widths[part]);
        let factor = factor(&corpus.relative, part, 1.0);
        let all = rows(points.values(part), width);
        let centre = all.mean_dim([0i64].as_slice(), true, Kind::Float).nan_to_num(0.0, 0.0, 0.0);
        drop(all);
        let empty = (Tensor::new(), Arc::from([]));
        let mut slide = Self { part, centre, rows: empty.0, squares: empty.1, factor, moved: 0.0 };
        let Placed { rows, squares, moved } = slide.place(corpus, points, (0, points.count()));
        slide.rows = rows * (-2.0 * factor);
        (slide.squares, slide.moved) = (squares, moved);
        slide
    }

    /// A copy for another thread.
    pub(crate) fn share(&self) -> Self {
        Self {
            centre: self.centre.shallow_clone(),
            rows: self.rows.shallow_clone(),
            squares: Arc::clone(&self.squares),
            ..*self
        }
    }

    /// Points `from..to`, of those of the index or of queries.
    pub(crate) fn place(&self, corpus: &Corpus, points: &Points, (from, to): (usize, usize)) -> Placed {
        let (width, length) = (points.shape().widths[self.part], points.shape().length);
        let (first, end) = points.rows_of((from, to));
        let rows = rows(&points.values(self.part)[first * width..end * width], width) - &self.centre;
        if from == to {
            return Placed { rows, squares: Arc::from([]), moved: 0.0 };
        }
        let largest = rows.abs().max().double_value(&[]);
        #[expect(clippy::cast_precision_loss, reason = "a point's width is small")]
        let longest = largest * ((width * length) as f64).sqrt() * 1.001;
        let of_rows: Vec<f32> = Vec::try_from(squares(&rows)).unwrap_or_default();
        let (shrink, factor) = (margin(width * length), self.factor);
        let square = |at: usize| {
            let begin = points.first_row(at) - first;
            let square: f64 = of_rows[begin..begin + length].iter().map(|square| f64::from(*square)).sum();
            #[expect(clippy::cast_possible_truncation, reason = "the rounding is in the margin")]
            let shrunk = (square * shrink * factor - UNDERFLOW) as f32;
            shrunk
        };
        Placed { rows, squares: (from..to).map(square).collect(), moved: corpus.frame.moved(longest) }
    }
}

impl Bounds {
    /// Room for this many bounds of all rows together.
    pub(crate) fn of_size(size: usize) -> Self {
        Self { all: vec![0.0; size], lows: vec![0.0; size / GROUP], ..Self::default() }
    }

    /// Replaces the content by the bounds of the `open` ones of queries `begin..end`, placed by `slides`, to points
    /// `from..to`.
    pub(crate) fn fill(
        &mut self,
        corpus: &Corpus,
        slides: &[Slide; PARTS],
        (queries, placed, (begin, end)): (&Points, &[Placed; PARTS], (usize, usize)),
        (open, (from, to)): (&[usize], (usize, usize)),
    ) {
        let points = &corpus.points;
        let width = (to - from).next_multiple_of(GROUP);
        self.all.clear();
        self.all.resize(open.len() * width, 0.0);
        let tile = points.rows_of((from, to));
        let runs = runs(points, (from, to));
        let across = tile.1 - tile.0;
        let (needed, firsts) = needed(queries, (begin, end), open);
        let down = needed.len();
        let needed = Tensor::from_slice(&needed);
        for (slide, placed) in slides.iter().zip(placed).filter(|(slide, _)| slide.factor > 0.0) {
            let rows = placed.rows.index_select(0, &needed);
            let products = rows.mm(&slide.rows.narrow(0, int(tile.0), int(across)).tr());
            self.products.resize(down * across, 0.0);
            products.copy_data(&mut self.products, down * across);
            for ((row, query), &first) in self.all.chunks_exact_mut(width).zip(open).zip(&firsts) {
                for &(at, start, count) in &runs {
                    self.sums.clear();
                    self.sums.resize(count, 0.0);
                    for step in 0..points.shape().length {
                        let products = &self.products[(first + step) * across + start + step..][..count];
                        add(&mut self.sums, products);
                    }
                    let squares = &slide.squares[from + at..][..count];
                    finish(&self.sums, (squares, placed.squares[*query]), &mut row[at..at + count]);
                }
            }
        }
        self.lows.clear();
        for row in self.all.chunks_exact_mut(width) {
            row[to - from..].fill(f32::INFINITY);
            let (least, others) = row.split_at(width / GROUP);
            let begin = self.lows.len();
            self.lows.extend_from_slice(least);
            others.chunks_exact(width / GROUP).for_each(|other| lower(&mut self.lows[begin..], other));
        }
    }
}

/// The rows of the `open` ones of queries `begin..end`, each once and numbered from the first of all, and for each query the
/// place of its first among them.
fn needed(queries: &Points, (begin, end): (usize, usize), open: &[usize]) -> (Vec<i64>, Vec<usize>) {
    let all = queries.rows_of((begin, end)).0;
    let length = queries.shape().length;
    let (mut needed, mut firsts) = (Vec::new(), Vec::with_capacity(open.len()));
    let mut end = 0;
    for query in open {
        let first = queries.first_row(begin + query) - all;
        // Queries rise, so the rows that this one shares with the last are the last ones.
        let shared = end.max(first) - first;
        firsts.push(needed.len() - shared);
        needed.extend((first + shared..first + length).map(int));
        end = first + length;
    }
    (needed, firsts)
}

/// The sequences of points `from..to` whose windows begin one row after another: the place of the first among them, its
/// first row among theirs, and their number.
fn runs(points: &Points, (from, to): (usize, usize)) -> Vec<(usize, usize, usize)> {
    let first = points.rows_of((from, to)).0;
    let mut runs: Vec<(usize, usize, usize)> = Vec::new();
    for at in from..to {
        let row = points.first_row(at) - first;
        match runs.last_mut() {
            Some((_, start, count)) if *start + *count == row => *count += 1,
            _ => runs.push((at - from, row, 1)),
        }
    }
    runs
}

#[multiversion(targets("x86_64+avx512f+avx512vl", "x86_64+avx2"))]
fn add(sums: &mut [f32], more: &[f32]) {
    sums.iter_mut().zip(more).for_each(|(sum, more)| *sum += more);
}

/// Adds the roots of the squared distances to `to`.
#[multiversion(targets("x86_64+avx512f+avx512vl", "x86_64+avx2"))]
fn finish(products: &[f32], (squares, square): (&[f32], f32), to: &mut [f32]) {
    for ((to, product), other) in to.iter_mut().zip(products).zip(squares) {
        *to += (product + other + square).max(0.0).sqrt();
    }
}

#[multiversion(targets("x86_64+avx512f+avx512vl", "x86_64+avx2"))]
fn lower(least: &mut [f32], others: &[f32]) {
    least.iter_mut().zip(others).for_each(|(least, other)| *least = least.min(*other));
}
