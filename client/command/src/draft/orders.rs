//! In which order of their values candidates of several ways are the same numbers.
//!
//! Works on candidates alone.

use gleaner_recording::ValueRange;

use super::candidate::{Candidate, Order};

/// Fits that differ by less are equal, and the likelier order is taken.
const EQUAL: f64 = 1e-6;

/// The place of one of a candidate's orders, and how well it fits.
type Fit = (usize, f64);

/// How well two candidates fit in their best orders, from 0 to 1; `None` if they have no orders of the same size.
pub(super) fn best(one: &Candidate, other: &Candidate) -> Option<f64> {
    one.orders.iter().filter_map(|order| like(order, other)).map(|(_, fit)| fit).reduce(f64::max)
}

/// The order of `one` that fits those of all `others` best together, and for each of these its own order and its fit.
pub(super) fn agreed(one: &Candidate, others: &[&Candidate]) -> (usize, Vec<Fit>) {
    let mut best: Option<(f64, usize, Vec<Fit>)> = None;
    for (own, order) in one.orders.iter().enumerate() {
        let theirs: Vec<_> = others.iter().map(|other| like(order, other).unwrap_or_default()).collect();
        let fit = theirs.iter().map(|(_, fit)| fit).sum();
        if best.as_ref().is_none_or(|(known, ..)| fit > known + EQUAL) {
            best = Some((fit, own, theirs));
        }
    }
    best.map_or_else(|| (0, vec![(0, 0.0); others.len()]), |(_, own, theirs)| (own, theirs))
}

/// The order of a candidate that fits this one best, and how well; `None` if none has its size.
fn like(order: &Order, candidate: &Candidate) -> Option<Fit> {
    let mut best: Option<Fit> = None;
    for (at, theirs) in candidate.orders.iter().enumerate() {
        if order.ranges.len() != theirs.ranges.len() {
            continue;
        }
        // Names that both have are the same joints.
        let named = !order.names.is_empty() && !theirs.names.is_empty();
        let fit = if named { f64::from(u8::from(order.names == theirs.names)) } else { overlap(order, theirs) };
        if best.is_none_or(|(_, known)| fit > known + EQUAL) {
            best = Some((at, fit));
        }
    }
    best
}

/// How much the ranges of two orders overlap, from 0 to 1.
#[expect(clippy::cast_precision_loss, reason = "a field has few values")]
fn overlap(one: &Order, other: &Order) -> f64 {
    let of_value = |(one, other): (&ValueRange, &ValueRange)| {
        let apart = (one.minimum - other.minimum).abs() + (one.maximum - other.maximum).abs();
        let span = (one.maximum - one.minimum) + (other.maximum - other.minimum);
        (1.0 - apart / (span + 1e-2)).max(0.0)
    };
    let sum: f64 = one.ranges.iter().zip(&other.ranges).map(of_value).sum();
    sum / one.ranges.len().max(1) as f64
}
