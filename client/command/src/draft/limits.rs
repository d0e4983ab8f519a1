//! Values and limits of an action as the draft writes them. Pure functions on numbers.

use gleaner_recording::ValueRange;

/// The least and the greatest of observed values, rounded outward to three significant digits, as numbers or lists of TOML.
/// `None` where nothing moves, which gives no limits.
pub(super) fn written(ranges: &[ValueRange]) -> Option<[String; 2]> {
    let [low, high] = if are_listed(ranges) {
        let each: Vec<[String; 2]> = ranges.iter().copied().filter_map(outward).collect();
        [0, 1].map(|bound| {
            let texts: Vec<&str> = each.iter().map(|texts| texts[bound].as_str()).collect();
            format!("[{}]", texts.join(", "))
        })
    } else {
        outward(ranges.iter().copied().reduce(ValueRange::with)?)?
    };
    Some([low, high])
}

/// Whether each value gets limits of its own: all of them move, and not all alike.
pub(super) fn are_listed(ranges: &[ValueRange]) -> bool {
    let each: Vec<Option<[String; 2]>> = ranges.iter().copied().map(outward).collect();
    each.iter().all(Option::is_some) && each.windows(2).any(|pair| pair[0] != pair[1])
}

fn outward(range: ValueRange) -> Option<[String; 2]> {
    let ValueRange { minimum, maximum } = range;
    (minimum < maximum).then(|| [shown(minimum, f64::floor), shown(maximum, f64::ceil)])
}

/// A value with at most three decimals.
pub(super) fn short(value: f64) -> String {
    format!("{value:.3}").trim_end_matches('0').trim_end_matches('.').to_owned()
}

fn shown(value: f64, round: impl Fn(f64) -> f64) -> String {
    let size = if value == 0.0 { 0.0 } else { value.abs().log10().floor() };
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a few digits, at least one")]
    let digits = (2.0 - size).clamp(1.0, 30.0) as usize;
    let scale = 10_f64.powf((2.0 - size).clamp(1.0, 30.0));
    let text = format!("{:.digits$}", round(value * scale) / scale);
    let short = text.trim_end_matches('0');
    if short.ends_with('.') { format!("{short}0") } else { short.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_that_differ_have_a_list() {
        let range = |minimum, maximum| ValueRange { minimum, maximum };
        let of = |ranges: &[ValueRange]| written(ranges).map(|[low, high]| format!("{low} {high}"));
        assert_eq!(of(&[range(-0.5, 0.5), range(-0.2, 1.25)]).unwrap(), "[-0.5, -0.2] [0.5, 1.25]");
        assert_eq!(of(&[range(-0.5, 0.5), range(-0.5, 0.5)]).unwrap(), "-0.5 0.5");
        // A value that stays where it is has no limits of its own.
        assert_eq!(of(&[range(-0.5, 0.5), range(0.1, 0.1)]).unwrap(), "-0.5 0.5");
        assert_eq!(of(&[range(0.1, 0.1)]), None);
        assert_eq!(of(&[]), None);
    }

    #[test]
    fn limits_hold_the_observed_values() {
        let of = |minimum, maximum| outward(ValueRange { minimum, maximum });
        let texts = |low: &str, high: &str| Some([low.to_owned(), high.to_owned()]);
        assert_eq!(of(-0.25, 0.5), texts("-0.25", "0.5"));
        assert_eq!(of(0.0, 0.0124), texts("0.0", "0.0124"));
        assert_eq!(of(-0.000_41, 0.000_412_3), texts("-0.00041", "0.000413"));
        assert_eq!(of(-1234.5, 99.91), texts("-1234.5", "100.0"));
        assert_eq!(of(0.3, 0.3), None);
        for value in [-0.1, 0.1, 0.7, 1.0 / 3.0, 1e-9, 123.456] {
            let [low, high] = of(value, value + value.abs()).unwrap().map(|text| text.parse::<f64>().unwrap());
            assert!(low <= value && high >= value + value.abs(), "{value}: {low} {high}");
        }
    }
}
