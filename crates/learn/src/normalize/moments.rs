//! Means and deviations of rows of numbers, in one pass over the rows.

use tch::{Device, Tensor};

use super::Standard;

/// The mean of each dimension and the squared distances from it, updated row by row (Welford 1962): unlike sums of
/// squares, they lose nothing where a mean is large beside its deviation.
pub(super) struct Moments {
    count: f64,
    mean: Vec<f64>,
    squares: Vec<f64>,
}

impl Moments {
    pub(super) fn new(width: usize) -> Self {
        Self { count: 0.0, mean: vec![0.0; width], squares: vec![0.0; width] }
    }

    pub(super) fn add(&mut self, row: &[f32]) {
        self.count += 1.0;
        let part = self.count.recip();
        for ((mean, squares), value) in self.mean.iter_mut().zip(&mut self.squares).zip(row) {
            let value = f64::from(*value);
            let before = value - *mean;
            *mean += before * part;
            *squares += before * (value - *mean);
        }
    }

    /// The statistics of the rows so far.
    pub(super) fn standard(self, device: Device) -> Standard {
        let [mean, squares] = [self.mean, self.squares].map(|values| Tensor::from_slice(&values));
        let deviation = (squares / self.count.max(1.0)).sqrt();
        Standard::new(&mean, &deviation, &mean, device)
    }
}

impl Standard {
    /// Statistics per dimension of rows of `width` values.
    pub(crate) fn of_rows<'a>(rows: impl Iterator<Item = &'a [f32]>, width: usize, device: Device) -> Self {
        let mut moments = Moments::new(width);
        rows.for_each(|row| moments.add(row));
        moments.standard(device)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::batch::values;

    #[test]
    fn one_pass_gives_what_two_give_even_far_from_zero() {
        let rows: Vec<[f32; 3]> = (0..1000u16)
            .map(|at| {
                let value = f32::from(at.wrapping_mul(7919) % 1000);
                [value, 1.0e6 + value / 8.0, -3.25]
            })
            .collect();
        let mut moments = Moments::new(3);
        rows.iter().for_each(|row| moments.add(row));
        let standard = moments.standard(Device::Cpu);
        let column = |at: usize| rows.iter().map(move |row| f64::from(row[at]));
        for at in [0, 1] {
            let mean = column(at).sum::<f64>() / 1000.0;
            let deviation = (column(at).map(|value| (value - mean).powi(2)).sum::<f64>() / 1000.0).sqrt();
            let found = [&standard.mean, &standard.deviation].map(|tensor| f64::from(values(tensor)[at]));
            assert!((found[0] / mean - 1.0).abs() < 1e-7, "{found:?} {mean}");
            assert!((found[1] / deviation - 1.0).abs() < 1e-6, "{found:?} {deviation}");
        }
        assert_eq!([&standard.mean, &standard.deviation].map(|tensor| values(tensor)[2]), [-3.25, 1.0]);
    }
}
