//! Sums over byte codes, sixteen at a time: for processors that multiply bytes, and the same sums in plain code. The choice
//! between the two is made at run time. Independent of metrics.

mod plain;
#[cfg(target_arch = "x86_64")]
mod vnni;

use multiversion::multiversion;
use multiversion::target::match_target;

/// Values worked on together.
pub(crate) const WIDE: usize = 16;
/// Codes that are multiplied and added together: the bytes of an `i32`.
pub(crate) const CODES: usize = 4;
/// The largest code.
pub(crate) const MOST: f32 = 127.0;
/// Queries worked on together.
pub(crate) const QUERIES: usize = 4;
/// Panels that queries are compared with at a time, at most: one bit each of their points.
pub(crate) const PANELS: usize = 4;

/// Values side by side in memory as the processor takes them.
#[derive(Debug, Clone, Copy)]
#[repr(C, align(64))]
pub(crate) struct Lanes<T>(pub(crate) [T; WIDE]);

/// What is to be known of a row of codes.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Sums {
    /// Of the codes, and of their squares: whole numbers, exact.
    pub(crate) codes: f32,
    pub(crate) squares: f32,
    /// Of the squares of what rounding to codes left, in steps.
    pub(crate) rests: f32,
}

/// What turns a query's products with points' codes into bounds, of one part.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Terms {
    /// What products begin with: points' codes are kept 128 larger, as bytes without a sign.
    pub(crate) begin: i32,
    /// −2 × the factor × both steps.
    pub(crate) factor: f32,
    /// The query's square.
    pub(crate) square: f32,
}

/// A query's codes, four to a number, and their terms.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Query<'a> {
    pub(crate) codes: &'a [i32],
    pub(crate) terms: &'a [Terms; 3],
    /// Larger bounds are of no interest.
    pub(crate) limit: f32,
}

/// A few panels of sixteen points each.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Panels<'a> {
    /// Per panel, part and four codes: those codes of each of the sixteen.
    pub(crate) codes: &'a [Lanes<i32>],
    /// Per panel and part: the points' squares.
    pub(crate) squares: &'a [Lanes<f32>],
    /// How often four codes, per part.
    pub(crate) groups: [usize; 3],
    /// In all.
    pub(crate) all: usize,
    pub(crate) count: usize,
    /// Whether distances are the roots of what is added up.
    pub(crate) roots: bool,
}

/// Whether this processor multiplies bytes.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx512vnni"))]
pub(crate) fn fast() -> bool {
    match_target! {
        "x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx512vnni" => true,
        _ => false,
    }
}

/// Writes `row` less `centre` to `to`, both padded with zeros; the largest value's size.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx512vnni"))]
pub(crate) fn centre(row: &[f32], centre: &[Lanes<f32>], to: &mut [Lanes<f32>]) -> f32 {
    match_target! {
        "x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx512vnni" => vnni::centre(row, centre, to),
        _ => plain::centre(row, centre, to),
    }
}

/// Writes the codes of `values`, multiples of 1 / `inverse`, to `codes`.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx512vnni"))]
pub(crate) fn code(values: &[Lanes<f32>], inverse: f32, codes: &mut [i32]) -> Sums {
    match_target! {
        "x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx512vnni" => vnni::code(values, inverse, codes),
        _ => plain::code(values, inverse, codes),
    }
}

/// Per query and panel, to `to`, the sums over parts of max(0, square + square + factor ×
/// product), or of its roots. Per query one bit for each that does not exceed its limit.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx512vnni"))]
pub(crate) fn bounds(
    queries: &[Query<'_>; QUERIES],
    panels: &Panels<'_>,
    to: &mut [[Lanes<f32>; PANELS]; QUERIES],
) -> [u64; QUERIES] {
    match_target! {
        "x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx512vnni" => vnni::bounds(queries, panels, to),
        _ => plain::bounds(queries, panels, to),
    }
}

#[cfg(test)]
mod tests;
