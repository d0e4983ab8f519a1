//! The sums of a step's numbers over its batches, read from the device at once. Independent of their meaning.

use tch::{Device, Kind, Tensor, no_grad_guard};

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

    /// The gradient norm (0 without one) and the sums, by one copy: reading a number waits for the device.
    pub(super) fn read(self, norm: Option<Tensor>) -> (f64, Metrics) {
        let _no_grad = no_grad_guard();
        let scalars = norm.iter().chain(self.values.iter().map(|(_, value, _)| value));
        let scalars: Vec<Tensor> = scalars.map(|scalar| scalar.to_kind(Kind::Double)).collect();
        let mut read = vec![0f64; scalars.len()];
        if !read.is_empty() {
            Tensor::stack(&scalars, 0).to_device(Device::Cpu).copy_data(&mut read, scalars.len());
        }
        let mut read = read.into_iter();
        let norm = norm.map_or(0.0, |_| read.next().unwrap_or(f64::NAN));
        let mut sums = Metrics::new();
        for ((name, _, divisor), value) in self.values.into_iter().zip(read) {
            match sums.iter_mut().find(|(known, _)| *known == name) {
                Some((_, sum)) => *sum += value / divisor,
                None => sums.push((name, value / divisor)),
            }
        }
        (norm, sums)
    }
}
