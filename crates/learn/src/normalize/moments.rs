//! Sums over rows of numbers, row by row: means, then deviations from them, and values that never change.

use tch::{Device, Tensor};

use super::Standard;

/// The first pass: sums of each dimension.
pub(super) struct Moments {
    count: f64,
    sums: Vec<f64>,
}

/// The second pass: squared distances from the means.
pub(super) struct Spread {
    count: f64,
    mean: Vec<f64>,
    variance: Vec<f64>,
}

impl Moments {
    pub(super) fn new(width: usize) -> Self {
        Self { count: 0.0, sums: vec![0.0; width] }
    }

    pub(super) fn add(&mut self, row: &[f32]) {
        self.count += 1.0;
        self.sums.iter_mut().zip(row).for_each(|(sum, value)| *sum += f64::from(*value));
    }

    /// The second pass, over the same rows.
    pub(super) fn spread(self) -> Spread {
        let Self { count, sums: mut mean } = self;
        mean.iter_mut().for_each(|sum| *sum /= count.max(1.0));
        Spread { count, variance: vec![0.0; mean.len()], mean }
    }
}

impl Spread {
    pub(super) fn add(&mut self, row: &[f32]) {
        let each = self.variance.iter_mut().zip(&self.mean).zip(row);
        each.for_each(|((sum, mean), value)| *sum += (f64::from(*value) - mean).powi(2) / self.count);
    }

    pub(super) fn standard(self, device: Device) -> Standard {
        let [mean, variance] = [self.mean, self.variance].map(|values| Tensor::from_slice(&values));
        Standard::new(&mean, &variance.sqrt(), &mean, device)
    }
}

/// Which dimensions change, and the values of the others.
#[derive(Default)]
pub(super) struct Held {
    first: Option<Vec<f32>>,
    moves: Vec<bool>,
}

impl Held {
    pub(super) fn add(&mut self, row: &[f32]) {
        let Some(first) = &self.first else {
            (self.first, self.moves) = (Some(row.to_vec()), vec![false; row.len()]);
            return;
        };
        self.moves.iter_mut().zip(first.iter().zip(row)).for_each(|(moves, (first, now))| *moves |= first != now);
    }

    /// Per dimension whether the rows differ (1 or 0), and their value where they do not, `[2, width]`.
    pub(super) fn tensor(self, width: usize, device: Device) -> Tensor {
        let value = self.first.unwrap_or_else(|| vec![0.0; width]);
        let each = (0..width).map(|at| if self.moves.get(at) == Some(&true) { (1f32, 0.0) } else { (0.0, value[at]) });
        let (moves, value): (Vec<f32>, Vec<f32>) = each.unzip();
        Tensor::from_slice2(&[moves, value]).to_device(device)
    }
}
