//! How far seeds scatter: their deviation, and Student's 95 % interval of their mean.
//!
//! Plain functions over plain numbers.

use statrs::distribution::{ContinuousCDF as _, StudentsT};

use crate::quality::mean;

/// A deviation up to this is rounding: means and differences of equal rates are not exact.
const ROUNDING: f64 = 1e-9;

/// The standard deviation of a sample (divisor n − 1); of two values or more.
#[expect(clippy::cast_precision_loss, reason = "there are few seeds")]
pub(crate) fn deviation(values: &[f64]) -> Option<f64> {
    let centre = mean(values).filter(|_| values.len() > 1)?;
    let squares: f64 = values.iter().map(|value| (value - centre).powi(2)).sum();
    Some((squares / (values.len() - 1) as f64).sqrt())
}

/// The 95 % t-interval of the mean, `(low, high)`: mean ± t(0.975; n − 1) · deviation / √n. Where
/// [`wilson`](gleaner_core::statistics::wilson) is about the rate of one trained policy, this is about the mean over
/// trainings. `None` unless there are two values that differ: equal ones have no deviation to estimate from.
#[expect(clippy::cast_precision_loss, reason = "there are few seeds")]
pub(crate) fn student(values: &[f64]) -> Option<(f64, f64)> {
    let deviation = deviation(values).filter(|deviation| *deviation > ROUNDING)?;
    let (centre, count) = (mean(values)?, values.len() as f64);
    let quantile = StudentsT::new(0.0, 1.0, count - 1.0).ok()?.inverse_cdf(0.975);
    let half = quantile * deviation / count.sqrt();
    Some((centre - half, centre + half))
}

#[cfg(test)]
mod tests {
    use super::*;

    // Quantiles from printed tables.
    #[test]
    fn the_interval_is_students() {
        let near = |values: &[f64], half: f64| {
            let (low, high) = student(values).unwrap();
            let centre = mean(values).unwrap();
            assert!((high - centre - half).abs() < 1e-3 && (centre - low - half).abs() < 1e-3, "{low} {high}");
        };
        // Deviation √2, n = 2, 1 degree of freedom.
        near(&[1.0, 3.0], 12.706);
        // Deviation 1, n = 3.
        near(&[1.0, 2.0, 3.0], 4.303 / 3.0_f64.sqrt());
        // Deviation √2.5, n = 5.
        near(&[1.0, 2.0, 3.0, 4.0, 5.0], 2.776 * 2.5_f64.sqrt() / 5.0_f64.sqrt());
    }

    #[test]
    fn one_seed_or_equal_seeds_have_no_interval() {
        assert_eq!((student(&[]), student(&[0.5]), student(&[0.5, 0.5, 0.5])), (None, None, None));
        // In binary their means and differences are not exact.
        assert_eq!((student(&[0.7; 3]), student(&[0.8 - 0.3, 0.7 - 0.2])), (None, None));
        assert_eq!((deviation(&[0.5]), deviation(&[0.5, 0.5])), (None, Some(0.0)));
    }
}
