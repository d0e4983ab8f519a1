//! Sums over byte codes, sixteen at a time: for processors that multiply bytes, and, the same, as
//! anyone would write it. Which of the two is used is found out at run time. Knows no metric.

mod plain;
#[cfg(target_arch = "x86_64")]
mod vnni;

use multiversion::multiversion;
use multiversion::target::match_target;

/// Values worked on together.
pub(super) const WIDE: usize = 16;
/// Codes that are multiplied and added together: the bytes of an `i32`.
pub(super) const CODES: usize = 4;
/// The largest code.
pub(super) const MOST: f32 = 127.0;
/// Queries worked on together.
pub(super) const QUERIES: usize = 4;
/// Panels that queries are compared with at a time, at most: one bit each of their experts.
pub(super) const PANELS: usize = 4;

/// Values side by side in memory as the processor takes them.
#[derive(Debug, Clone, Copy)]
#[repr(C, align(64))]
pub(super) struct Lanes<T>(pub(super) [T; WIDE]);

/// What is to be known of a row of codes.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Sums {
    /// Of the codes, and of their squares: whole numbers, exact.
    pub(super) codes: f32,
    pub(super) squares: f32,
    /// Of the squares of what rounding to codes left, in steps.
    pub(super) rests: f32,
}

/// What turns a query's products with experts' codes into bounds, of one modality.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Terms {
    /// What products begin with: experts' codes are kept 128 larger, as bytes without a sign.
    pub(super) begin: i32,
    /// −2 × the factor × both steps.
    pub(super) factor: f32,
    /// The query's square.
    pub(super) square: f32,
}

/// A query's codes, four to a number, and their terms.
#[derive(Debug, Clone, Copy)]
pub(super) struct Query<'a> {
    pub(super) codes: &'a [i32],
    pub(super) terms: &'a [Terms; 3],
    /// Larger bounds are of no interest.
    pub(super) limit: f32,
}

/// A few panels of sixteen experts each.
#[derive(Debug, Clone, Copy)]
pub(super) struct Panels<'a> {
    /// Per panel, modality and four codes: those codes of each of the sixteen.
    pub(super) codes: &'a [Lanes<i32>],
    /// Per panel and modality: the experts' squares.
    pub(super) squares: &'a [Lanes<f32>],
    /// How often four codes, per modality.
    pub(super) groups: [usize; 3],
    /// In all.
    pub(super) all: usize,
    pub(super) count: usize,
    /// Whether distances are the roots of what is added up.
    pub(super) roots: bool,
}

/// Whether this processor multiplies bytes.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx512vnni"))]
pub(super) fn fast() -> bool {
    match_target! {
        "x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx512vnni" => true,
        _ => false,
    }
}

/// Writes `row` less `centre` to `to`, both padded with zeros; the largest value's size.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx512vnni"))]
pub(super) fn centre(row: &[f32], centre: &[Lanes<f32>], to: &mut [Lanes<f32>]) -> f32 {
    match_target! {
        "x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx512vnni" => vnni::centre(row, centre, to),
        _ => plain::centre(row, centre, to),
    }
}

/// Writes the codes of `values`, multiples of 1 / `inverse`, to `codes`.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx512vnni"))]
pub(super) fn code(values: &[Lanes<f32>], inverse: f32, codes: &mut [i32]) -> Sums {
    match_target! {
        "x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx512vnni" => vnni::code(values, inverse, codes),
        _ => plain::code(values, inverse, codes),
    }
}

/// Per query and panel, to `to`, the sums over modalities of max(0, square + square + factor ×
/// product), or of its roots. Per query one bit for each that does not exceed its limit.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx512vnni"))]
pub(super) fn bounds(
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
