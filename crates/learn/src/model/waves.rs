//! A number as sines and cosines of several periods, so that layers tell near and far numbers apart. Independent of
//! what the number is.

use tch::{Device, Kind, Tensor};

/// Waves whose periods grow by a constant factor.
pub(crate) struct Waves {
    /// `[width / 2]`: 2 π over the period of each wave.
    frequencies: Tensor,
}

impl Waves {
    /// Waves with periods from the shortest to the longest, for embeddings of an even `width`.
    pub(crate) fn new(periods: [f64; 2], width: i64, device: Device) -> Self {
        let [shortest, longest] = periods.map(f64::ln);
        let periods = Tensor::linspace(shortest, longest, width / 2, (Kind::Double, device)).exp();
        Self { frequencies: (periods.reciprocal() * std::f64::consts::TAU).to_kind(Kind::Float) }
    }

    /// Numbers `[…, 1]` to their embeddings `[…, width]`.
    pub(crate) fn of(&self, numbers: &Tensor) -> Tensor {
        let angle = numbers * self.frequencies.to_kind(numbers.kind());
        Tensor::cat(&[angle.sin(), angle.cos()], -1)
    }
}
