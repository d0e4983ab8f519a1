//! A cheaper filter first: rows seen only along the few directions in which the experts differ
//! most. A projection never makes a distance longer, ‖P x − P y‖ ≤ ‖x − y‖, so what it rules out
//! is ruled out; a narrower product is all it costs. Knows nothing of tiles.

use rand::RngExt;
use tch::{Device, Kind, Tensor};

use super::bound::{Framed, U};
use crate::batch::{int, rows, values};
use crate::random::{Purpose, generator};

/// Narrower rows are not worth projecting.
const LEAST_WIDTH: usize = 96;
/// Fewer rows than this a direction say too little of where rows differ, and cost too little.
const ROWS_A_DIRECTION: usize = 16;
/// More than this and the directions are not what they should be.
const MOST_STRETCH: f64 = 1.001;
/// Rows looked at to find them.
const SAMPLE: usize = 2048;

/// Some directions of one modality.
pub(super) struct Directions {
    /// `[count, d]`, orthonormal but for rounding.
    basis: Vec<f32>,
    count: usize,
    /// At least the most that rounding lets them stretch a row.
    pub(super) stretch: f64,
}

impl Directions {
    /// The principal directions of `framed`; `None` if a narrower product would not pay.
    pub(super) fn principal(framed: &Framed) -> Option<Self> {
        let count = (framed.width / 8).clamp(32, 128);
        if framed.width < LEAST_WIDTH || framed.squares.len() < ROWS_A_DIRECTION * count {
            return None;
        }
        let every = framed.squares.len().div_ceil(SAMPLE);
        let sample: Vec<f32> = framed.rows.chunks_exact(framed.width).step_by(every).flatten().copied().collect();
        let all = rows(&sample, framed.width, Device::Cpu).to_kind(Kind::Double);
        // Subspace iteration from any start; how good the directions are changes only the speed.
        let mut rng = generator(0, Purpose::Weights, 0);
        let start: Vec<f64> = (0..framed.width * count).map(|_| rng.random_range(-1.0..1.0)).collect();
        let mut basis = Tensor::from_slice(&start).view([int(framed.width), int(count)]);
        for _ in 0..2 {
            basis = Tensor::linalg_qr(&all.tr().matmul(&all.matmul(&basis)), "reduced").0;
        }
        let basis = basis.tr().to_kind(Kind::Float).contiguous();
        let exact = basis.to_kind(Kind::Double);
        let sums = exact.matmul(&exact.tr()).abs().sum_dim_intlist([1i64].as_slice(), false, Kind::Double);
        // The largest row sum of |B Bᵀ| is at least its largest eigenvalue.
        let stretch = sums.max().double_value(&[]).sqrt().max(1.0);
        (stretch < MOST_STRETCH).then(|| Self { basis: values(&basis), count, stretch })
    }

    /// `framed` along these directions.
    pub(super) fn apply(&self, framed: &Framed) -> Framed {
        let basis = rows(&self.basis, framed.width, Device::Cpu);
        let projected = values(&rows(&framed.rows, framed.width, Device::Cpu).mm(&basis.tr()));
        // Each of the values errs by at most γ(d) ‖x‖, so all by √count times that.
        #[expect(clippy::cast_precision_loss, reason = "small counts")]
        let rounding = 1.1 * U * framed.width as f64 * (self.count as f64).sqrt() * self.stretch;
        Framed::new(projected, self.count, |row, _| {
            self.stretch * framed.moved[row] + rounding * framed.squares[row].sqrt() * 1.01
        })
    }
}
