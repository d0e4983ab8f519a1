//! A cheaper filter first: rows seen only along the few directions in which the points differ
//! most. A projection never makes a distance longer, ‖P x − P y‖ ≤ ‖x − y‖, so what it rules out
//! is ruled out; a narrower product is all it costs. Independent of tiles.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tch::{Kind, Tensor};

use crate::bound::{Frame, Framed, U};
use crate::points::Points;
use crate::tensor::int;

/// Narrower rows are not worth projecting.
const LEAST_WIDTH: usize = 96;
/// With fewer rows for each direction, the sample shows little of the differences of rows, and a full product is
/// cheap.
const ROWS_A_DIRECTION: usize = 16;
/// Largest accepted stretch; beyond it the directions are not orthonormal enough.
const MOST_STRETCH: f64 = 1.001;
/// Number of rows in the sample from which the directions are computed.
const SAMPLE: usize = 2048;

/// Some directions of one part.
pub(crate) struct Directions {
    /// `[d, count]`, orthonormal except for rounding.
    basis: Tensor,
    count: usize,
    /// Upper bound of the factor by which rounding stretches a row.
    pub(crate) stretch: f64,
}

impl Directions {
    /// The principal directions of `part` of the points; `None` if a narrower product would not pay.
    pub(crate) fn principal(points: &Points, frame: &Frame, part: usize) -> Option<Self> {
        let (width, rows) = (points.widths()[part], points.count());
        let count = (width / 8).clamp(16, 128);
        if width < LEAST_WIDTH || rows < ROWS_A_DIRECTION * count {
            return None;
        }
        let sample = (0..rows).step_by(rows.div_ceil(SAMPLE));
        let all = frame.rows(points, part, sample).to_kind(Kind::Double);
        // Subspace iteration from any start: the quality of the directions affects only the speed.
        let mut rng = ChaCha8Rng::seed_from_u64(0);
        let start: Vec<f64> = (0..width * count).map(|_| rng.random_range(-1.0..1.0)).collect();
        let mut basis = Tensor::from_slice(&start).view([int(width), int(count)]);
        for _ in 0..3 {
            basis = Tensor::linalg_qr(&all.tr().matmul(&all.matmul(&basis)), "reduced").0;
        }
        let basis = basis.to_kind(Kind::Float).contiguous();
        let exact = basis.to_kind(Kind::Double);
        let sums = exact.tr().matmul(&exact).abs().sum_dim_intlist([1i64].as_slice(), false, Kind::Double);
        // The largest row sum of |Bᵀ B| is at least its largest eigenvalue.
        let stretch = sums.max().double_value(&[]).sqrt().max(1.0);
        (stretch < MOST_STRETCH).then(|| Self { basis, count, stretch })
    }

    /// Number of directions.
    pub(crate) fn count(&self) -> usize {
        self.count
    }

    /// A copy for another thread.
    pub(crate) fn share(&self) -> Self {
        Self { basis: self.basis.shallow_clone(), ..*self }
    }

    /// The projection of `framed` onto these directions.
    pub(crate) fn apply(&self, framed: &Framed) -> Framed {
        // The error of each value is at most γ(d) ‖x‖, so that of all values at most √count times that.
        #[expect(clippy::cast_precision_loss, reason = "small counts")]
        let rounding = 1.1 * U * framed.width() as f64 * (self.count as f64).sqrt() * self.stretch;
        let moved = self.stretch * framed.moved + rounding * framed.longest();
        Framed::new(framed.rows.mm(&self.basis), |_| moved)
    }
}
