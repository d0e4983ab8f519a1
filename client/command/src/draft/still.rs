//! Numbers of an action that never change in the recordings: those that are always 0 are left out.
//!
//! Works on the sources of one field.

use gleaner_recording::{FieldSource, ValueRange};

use super::limits::short;

/// Takes the numbers that are always 0 out of the sources of an action and out of its ranges, and returns which. A robot
/// that is sent no value for them moves as in the recordings. Quaternions stay whole, and so do numbers without paths of
/// their own and actions that are always 0.
pub(super) fn leave_out_zeros(sources: &mut [FieldSource], ranges: &mut Vec<ValueRange>) -> Option<String> {
    if sources.iter().any(|source| source.paths.len() != ranges.len()) {
        return None;
    }
    let is_still = |at: usize, range: &ValueRange| {
        range.minimum == 0.0 && range.maximum == 0.0 && !sources.iter().any(|source| of_quaternion(source, at))
    };
    let still: Vec<bool> = ranges.iter().enumerate().map(|(at, range)| is_still(at, range)).collect();
    if still.iter().all(|is_still| *is_still) || !still.contains(&true) {
        return None;
    }
    let left: Vec<String> = kept(&sources[0].paths, |at| still[at]);
    for source in sources {
        source.paths = kept(&source.paths, |at| !still[at]);
    }
    *ranges = kept(ranges, |at| !still[at]);
    let (is, them) = if left.len() == 1 { ("is", "it") } else { ("are", "them") };
    Some(format!(
        "{} {is} always 0 in these recordings and left out: add {them} to `paths`, and to `size`, if the robot uses {them}.",
        left.join(", ")
    ))
}

/// Whether a number is a part of a rotation with a real part, such as `orientation.x` beside `orientation.w`.
fn of_quaternion(source: &FieldSource, at: usize) -> bool {
    let (part, axis) = cut(&source.paths[at]);
    let real = if axis.starts_with('q') { "qw" } else { "w" };
    source.paths.iter().any(|other| cut(other) == (part, real))
}

fn cut(path: &str) -> (&str, &str) {
    path.rsplit_once('.').unwrap_or(("", path))
}

fn kept<T: Clone>(values: &[T], keeps: impl Fn(usize) -> bool) -> Vec<T> {
    values.iter().enumerate().filter(|(at, _)| keeps(*at)).map(|(_, value)| value.clone()).collect()
}

/// Which numbers of an action never change.
pub(super) fn unchanged(paths: &[String], ranges: &[ValueRange]) -> Option<String> {
    let constant = |(path, range): (&String, &ValueRange)| {
        (range.minimum >= range.maximum).then(|| format!("{path} is always {}", short(range.minimum)))
    };
    let found: Vec<String> = paths.iter().zip(ranges).filter_map(constant).collect();
    let all = ranges.len() < 2 || paths.len() != ranges.len();
    (!all && !found.is_empty()).then(|| {
        format!(
            "{} in these recordings: remove these paths, and lower `size`, if the robot never uses them.",
            found.join(", ")
        )
    })
}
