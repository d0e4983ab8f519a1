//! Sums over byte codes, sixteen at a time: for processors that multiply bytes, and the same sums in plain code. The choice
//! between the two is made at run time. Independent of metrics.

mod plain;
#[cfg(target_arch = "x86_64")]
mod vnni;

use multiversion::multiversion;
use multiversion::target::match_target;

/// Values processed together.
pub(crate) const WIDE: usize = 16;
/// Codes that are multiplied and added together: the bytes of an `i32`.
pub(crate) const CODES: usize = 4;
/// The largest code.
pub(crate) const MOST: f32 = 127.0;
/// Queries processed together.
pub(crate) const QUERIES: usize = 4;
/// Maximum number of panels compared with queries at a time: one bit for each of their points.
pub(crate) const PANELS: usize = 4;

/// Values adjacent in memory, as the processor loads them.
#[derive(Debug, Clone, Copy)]
#[repr(C, align(64))]
pub(crate) struct Lanes<T>(pub(crate) [T; WIDE]);

/// Sums over at most 1024 codes.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Sums {
    /// Sum of the codes, and sum of their squares: whole numbers, exact.
    pub(crate) codes: f32,
    pub(crate) squares: f32,
    /// Sum of the squares of the rounding errors, in steps.
    pub(crate) rests: f32,
}

/// The terms that turn a query's products with points' codes into bounds, for one part.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Terms {
    /// Initial value of the products: it corrects for points' codes, which are stored plus 128 as unsigned bytes.
    pub(crate) begin: i32,
    /// −2 × the factor × both steps.
    pub(crate) factor: f32,
    /// The query's square.
    pub(crate) square: f32,
}

/// A query's codes, four in each number, and their terms.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Query<'a> {
    pub(crate) codes: &'a [i32],
    pub(crate) terms: &'a [Terms; 3],
    /// Larger bounds are not needed.
    pub(crate) limit: f32,
}

/// A few panels of sixteen points each.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Panels<'a> {
    /// Per panel, part and group of four codes: those codes of each of the sixteen points.
    pub(crate) codes: &'a [Lanes<i32>],
    /// Per panel and part: the points' squares.
    pub(crate) squares: &'a [Lanes<f32>],
    /// Number of groups of four codes, per part.
    pub(crate) groups: [usize; 3],
    /// Number of groups in all parts.
    pub(crate) all: usize,
    pub(crate) count: usize,
    /// Whether distances are the roots of the sums.
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

/// Writes `row` minus `centre` to `to`, both padded with zeros; returns the magnitude of the largest value.
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

/// Writes to `to`, per query and panel, the sums over parts of max(0, square + square + factor × product), or of its
/// roots. Returns per query one bit for each point whose sum does not exceed the limit.
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
