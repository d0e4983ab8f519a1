//! How two segments' features compare. Exact: double precision, a fixed order of additions.
//!
//! sim(τ_imp, τ_exp) = −‖z^o_imp − z^o_exp‖₂ − ‖z^m_imp − z^m_exp‖₂ − ‖z^a_imp − z^a_exp‖₂ at the
//! last step.

use super::features::Features;

/// The similarity `last_l2`, as a distance (its negative).
#[derive(Debug, Clone, Copy)]
pub(crate) struct LastL2 {
    /// Factors of the three distances.
    pub(crate) scale: [f64; 3],
}

impl LastL2 {
    /// Distances of o, m and a between row `i` of `a` and row `j` of `b`.
    pub(crate) fn parts(a: (&Features, usize), b: (&Features, usize)) -> [f64; 3] {
        std::array::from_fn(|modality| euclidean(a.0.row(modality, a.1), b.0.row(modality, b.1)))
    }

    /// The scaled sum of `parts`: minus the similarity.
    pub(crate) fn distance(&self, parts: [f64; 3]) -> f64 {
        let scaled = parts.iter().zip(&self.scale);
        scaled.map(|(part, scale)| part * scale).sum()
    }
}

fn euclidean(a: &[f32], b: &[f32]) -> f64 {
    let squares = a.iter().zip(b).map(|(a, b)| {
        let difference = f64::from(*a) - f64::from(*b);
        difference * difference
    });
    squares.sum::<f64>().sqrt()
}
