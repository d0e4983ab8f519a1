//! The range of a dataset's actions, by which they are rescaled to robomimic's [-1, 1]. Must not know HDF5.

use crate::export::Export;

/// The least and greatest value of each action; [-1, 1] for one that does not leave it.
pub(super) struct ActionRange {
    pub(super) low: Vec<f32>,
    pub(super) high: Vec<f32>,
}

impl ActionRange {
    pub(super) fn of<E: Export>(export: &mut E, size: usize) -> Result<Self, E::Error> {
        let (mut low, mut high) = (vec![f32::INFINITY; size], vec![f32::NEG_INFINITY; size]);
        for at in 0..export.pieces().len() {
            for row in export.numbers(at)?.action.chunks_exact(size.max(1)) {
                for ((low, high), &value) in low.iter_mut().zip(&mut high).zip(row) {
                    (*low, *high) = (low.min(value), high.max(value));
                }
            }
        }
        for (low, high) in low.iter_mut().zip(&mut high) {
            if *low >= -1.0 && *high <= 1.0 || low >= high {
                (*low, *high) = (low.min(-1.0), high.max(1.0));
            }
        }
        Ok(Self { low, high })
    }

    pub(super) fn rescaled(&self, actions: &[f32]) -> Vec<f32> {
        let rescale = |((&value, &low), &high): ((&f32, &f32), &f32)| {
            let within = if (low, high) == (-1.0, 1.0) { value } else { (value - low) / (high - low) * 2.0 - 1.0 };
            within.clamp(-1.0, 1.0)
        };
        let rows = actions.chunks_exact(self.low.len().max(1));
        rows.flat_map(|row| row.iter().zip(&self.low).zip(&self.high).map(rescale)).collect()
    }
}
