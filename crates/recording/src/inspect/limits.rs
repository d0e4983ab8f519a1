//! Recorded actions outside of the limits that the task gives them.

use gleaner_core::action::ActionRange;
use gleaner_core::{FieldSpec, FindingCode, Report, Severity};

use super::{columns, width};

/// Share of a range by which a value may leave it without a finding: rounding, or a controller that overshoots.
const TOLERATED: f32 = 0.01;

/// Values of an action that are beyond their limits at some steps, where they are learned as the limit.
pub(crate) fn outside_limits(values: &[f32], fields: &[FieldSpec], report: &mut Report) {
    let ranges = fields.iter().flat_map(ActionRange::of_values);
    for ((column, subject), range) in columns(fields).zip(ranges) {
        let (minimum, maximum, is_binary) = range.bounds();
        if is_binary || (minimum.is_none() && maximum.is_none()) {
            continue;
        }
        let span = maximum.or(minimum).unwrap_or_default() - minimum.unwrap_or_default();
        let tolerated = span.abs() * TOLERATED;
        let is_outside = |value: f32| (range.nearest(value) - value).abs() > tolerated;
        let rows = || values.chunks_exact(width(fields)).map(|row| row[column]);
        let Some(first) = rows().position(is_outside) else { continue };
        let count = rows().filter(|value| is_outside(*value)).count();
        let (low, high) = rows()
            .filter(|value| value.is_finite())
            .fold((f32::INFINITY, f32::NEG_INFINITY), |so_far, value| (so_far.0.min(value), so_far.1.max(value)));
        let limits = [("minimum", minimum), ("maximum", maximum)];
        let limits = limits.iter().filter_map(|(key, limit)| limit.map(|limit| format!("{key} {limit}")));
        let detail = format!(
            "at {count} of {} steps the action is outside of its limits, {}, and is learned as the nearest one: it is {low:.3} \
             to {high:.3}. Correct the limits of the task if the robot may move so",
            rows().count(),
            limits.collect::<Vec<_>>().join(" and ")
        );
        report.add(Severity::Warning, FindingCode::OutsideLimits, &subject, Some(first as u64), detail);
    }
}
