//! Values and limits of an action as the draft writes them. Pure functions on numbers.

use gleaner_recording::{Bound, ValueRange};

/// The least and the greatest of observed values, rounded outward to three significant digits: of each value, where all of
/// them move and not all alike, or else one of all. `None` where nothing moves, which gives no limits.
pub(super) fn bounds(ranges: &[ValueRange]) -> Option<[Bound; 2]> {
    let each: Option<Vec<[f64; 2]>> = ranges.iter().copied().map(outward).collect();
    if let Some(each) = each.filter(|each| each.windows(2).any(|pair| pair[0] != pair[1])) {
        return Some([0, 1].map(|side| Bound::Each(each.iter().map(|limits| single(limits[side])).collect())));
    }
    let all = outward(ranges.iter().copied().reduce(ValueRange::with)?)?;
    Some(all.map(|limit| Bound::All(single(limit))))
}

fn outward(range: ValueRange) -> Option<[f64; 2]> {
    let ValueRange { minimum, maximum } = range;
    (minimum < maximum).then(|| [rounded(minimum, f64::floor), rounded(maximum, f64::ceil)])
}

#[expect(clippy::cast_possible_truncation, reason = "steps hold 32-bit floats")]
pub(super) fn single(value: f64) -> f32 {
    value as f32
}

/// A value with at most three decimals.
pub(super) fn short(value: f64) -> String {
    format!("{value:.3}").trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// The value to three significant digits, or to one decimal if that is more.
fn rounded(value: f64, round: impl Fn(f64) -> f64) -> f64 {
    let size = if value == 0.0 { 0.0 } else { value.abs().log10().floor() };
    let scale = 10_f64.powf((2.0 - size).clamp(1.0, 30.0));
    round(value * scale) / scale
}

#[cfg(test)]
mod tests {
    use super::*;

    fn range(minimum: f64, maximum: f64) -> ValueRange {
        ValueRange { minimum, maximum }
    }

    #[test]
    fn values_that_differ_have_a_list() {
        let each = |bounds: &[f32]| Bound::Each(bounds.to_vec());
        let listed = bounds(&[range(-0.5, 0.5), range(-0.2, 1.25)]);
        assert_eq!(listed, Some([each(&[-0.5, -0.2]), each(&[0.5, 1.25])]));
        let all = Some([Bound::All(-0.5), Bound::All(0.5)]);
        assert_eq!(bounds(&[range(-0.5, 0.5), range(-0.5, 0.5)]), all);
        // A value that stays where it is has no limits of its own.
        assert_eq!(bounds(&[range(-0.5, 0.5), range(0.1, 0.1)]), all);
        assert_eq!(bounds(&[range(0.1, 0.1)]), None);
        assert_eq!(bounds(&[]), None);
    }

    #[test]
    fn limits_hold_the_observed_values() {
        let of = |minimum, maximum| bounds(&[range(minimum, maximum)]);
        let all = |minimum, maximum| Some([Bound::All(minimum), Bound::All(maximum)]);
        assert_eq!(of(-0.25, 0.5), all(-0.25, 0.5));
        assert_eq!(of(0.0, 0.0124), all(0.0, 0.0124));
        assert_eq!(of(-0.000_41, 0.000_412_3), all(-0.000_41, 0.000_413));
        assert_eq!(of(-1234.56, 99.91), all(-1234.6, 100.0));
        for value in [-0.1, 0.1, 0.7, 1.0 / 3.0, 1e-9, 123.456] {
            let [low, high] = outward(range(value, value + value.abs())).unwrap();
            assert!(low <= value && high >= value + value.abs(), "{value}: {low} {high}");
        }
    }
}
