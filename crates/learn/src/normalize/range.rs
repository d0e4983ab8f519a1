//! The ranges of actions in a sample, and which of them are constant. Independent of what becomes of them.

use super::{CONSTANT, Sample};
use crate::error::LearnError;
use crate::shape::TaskShape;

/// The least and the greatest value of each dimension of some rows.
pub(crate) struct Ranges(Vec<(f32, f32)>);

impl Ranges {
    pub(super) fn new(width: usize) -> Self {
        Self(vec![(f32::INFINITY, f32::NEG_INFINITY); width])
    }

    /// Those of the actions of a sample.
    ///
    /// # Errors
    /// [`LearnError::Steps`].
    pub(crate) fn of_actions(shape: &TaskShape, sample: &Sample<'_>) -> Result<Self, LearnError> {
        let mut ranges = Self::new(shape.action);
        sample.each(shape, &mut |_, action| ranges.add(action))?;
        Ok(ranges)
    }

    pub(super) fn add(&mut self, row: &[f32]) {
        for ((least, most), value) in self.0.iter_mut().zip(row) {
            (*least, *most) = (least.min(*value), most.max(*value));
        }
    }

    /// The middle of each range, and half its width; no width where that is rounding noise, so that the dimension is
    /// constant. The middle of no rows is 0.
    pub(crate) fn middles(&self) -> impl Iterator<Item = (f32, Option<f32>)> + '_ {
        self.0.iter().map(|(least, most)| match (least, most) {
            _ if least > most => (0.0, None),
            _ if least == most => (*least, None),
            _ => {
                let (middle, half) = (least / 2.0 + most / 2.0, most / 2.0 - least / 2.0);
                (middle, Some(half).filter(|half| f64::from(*half) > CONSTANT * (1.0 + f64::from(middle.abs()))))
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_range_of_rounding_noise_is_a_constant() {
        let mut ranges = Ranges::new(4);
        let noisy = 0.25f32;
        for row in [[-1.0, 7.0, noisy, 1000.0], [3.0, 7.0, noisy.next_up(), 1000.0f32.next_up()]] {
            ranges.add(&row);
        }
        let found: Vec<_> = ranges.middles().collect();
        assert_eq!(found[..2], [(1.0, Some(2.0)), (7.0, None)]);
        assert_eq!((found[2].1, found[3].1), (None, None));
        assert!((found[2].0 - noisy).abs() < 1e-6);
        assert_eq!(Ranges::new(1).middles().next(), Some((0.0, None)));
    }
}
