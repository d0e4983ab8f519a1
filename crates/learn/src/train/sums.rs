//! The sums of a step's numbers over its batches, on the device. Independent of their meaning.

use tch::Tensor;

/// Named values of one step.
pub(crate) type Metrics = Vec<(&'static str, f64)>;

/// The values of a step's batches that are still on the device.
#[derive(Default)]
pub(super) struct Sums {
    /// Name, scalar, and its divisor.
    values: Vec<(&'static str, Tensor, f64)>,
}

impl Sums {
    /// Adds `value / divisor` to the sum of this name.
    pub(super) fn add(&mut self, name: &'static str, value: &Tensor, divisor: f64) {
        self.values.push((name, value.detach(), divisor));
    }

    /// The numbers themselves, in the order in which they were added.
    pub(super) fn numbers(&mut self) -> Vec<&mut Tensor> {
        self.values.iter_mut().map(|(_, value, _)| value).collect()
    }

    /// The numbers that [`Sums::named`] needs.
    pub(super) fn scalars(&self) -> impl Iterator<Item = &Tensor> {
        self.values.iter().map(|(_, value, _)| value)
    }

    /// The sums, of the scalars as they were read.
    pub(super) fn named(self, read: &mut impl Iterator<Item = f64>) -> Metrics {
        let mut sums = Metrics::new();
        for ((name, _, divisor), value) in self.values.into_iter().zip(read) {
            match sums.iter_mut().find(|(known, _)| *known == name) {
                Some((_, sum)) => *sum += value / divisor,
                None => sums.push((name, value / divisor)),
            }
        }
        sums
    }
}
