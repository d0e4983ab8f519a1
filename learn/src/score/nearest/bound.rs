//! The filter: lower bounds of distances from single-precision matrix products, with a proven
//! margin. Knows nothing of which distances win.

use std::ops::Range;

use tch::{Device, Kind, Tensor};

use crate::batch::{int, rows};

/// Unit roundoff of single precision.
const U: f64 = 5.960_464_477_539_063e-8;
/// More than the relative rounding of the square roots and sums that follow the products.
const SLACK: f64 = 16.0 * U;

/// Rows of the three modalities, centred.
pub(super) struct Centred([Modality; 3]);

/// One modality's centred rows.
struct Modality {
    /// `[N, d]`.
    rows: Tensor,
    /// `[N]`: ‖x‖² less the margin ε ‖x‖² that makes the product a lower bound.
    squares: Tensor,
    /// ‖x‖ of every row.
    norms: Vec<f64>,
}

impl Modality {
    fn new(values: &[f32], centre: &[f32]) -> Self {
        let width = centre.len();
        let moved: Vec<f32> = values.chunks(width).flat_map(|row| row.iter().zip(centre).map(|(x, c)| x - c)).collect();
        let squares: Vec<f64> =
            moved.chunks(width).map(|row| row.iter().map(|x| f64::from(*x).powi(2)).sum()).collect();
        // The product errs by at most γ(d + 2) · 2 (‖x‖² + ‖y‖²), γ(n) ≈ n U, whatever the order of
        // its additions; rounding the two squares and their sum errs by at most 3 U (‖x‖² + ‖y‖²).
        #[expect(clippy::cast_precision_loss, reason = "a feature's width is small")]
        let epsilon = 2.5 * U * (width as f64 + 8.0);
        #[expect(clippy::cast_possible_truncation, reason = "the rounding is in the margin")]
        let shrunk: Vec<f32> = squares.iter().map(|s| (s * (1.0 - epsilon)) as f32).collect();
        Self {
            rows: rows(&moved, width, Device::Cpu),
            squares: Tensor::from_slice(&shrunk),
            norms: squares.iter().map(|s| s.sqrt()).collect(),
        }
    }

    /// Lower bounds of ‖x − y‖ to rows `from .. from + count` of `others`, `[N, count]`.
    fn lower_bounds(&self, others: &Self, from: i64, count: i64) -> Tensor {
        let squares = others.squares.narrow(0, from, count).unsqueeze(0);
        // Doubling is exact, so −2 x·y has the relative error of x·y.
        let doubled = &self.rows * -2.0;
        let mut bound =
            (self.squares.unsqueeze(1) + squares).addmm_(&doubled, &others.rows.narrow(0, from, count).tr());
        bound.clamp_min_(0.0).sqrt_()
    }
}

impl Centred {
    /// Centres `values` (row-major, per modality) at `centre`.
    pub(super) fn new(values: [&[f32]; 3], centre: &[Vec<f32>; 3]) -> Self {
        Self(std::array::from_fn(|i| Modality::new(values[i], &centre[i])))
    }

    /// Lower bounds of the scaled distances to `tile` of `others`, `[N, tile]`, up to what
    /// [`limit`] allows for; infinite where the tile meets `skip`.
    pub(super) fn lower_bounds(
        &self,
        others: &Self,
        scale: &[f64; 3],
        tile: &Range<usize>,
        skip: &Range<usize>,
    ) -> Tensor {
        let (from, count) = (int(tile.start), int(tile.len()));
        let size = [int(self.0[0].norms.len()), count];
        let mut sum: Option<Tensor> = None;
        for (i, scale) in scale.iter().enumerate().filter(|(_, scale)| **scale > 0.0) {
            let mut bound = self.0[i].lower_bounds(&others.0[i], from, count);
            if *scale != 1.0 {
                bound = bound.g_mul_scalar_(*scale);
            }
            sum = Some(match sum {
                Some(mut sum) => sum.g_add_(&bound),
                None => bound,
            });
        }
        let sum = sum.unwrap_or_else(|| Tensor::zeros(size, (Kind::Float, Device::Cpu)));
        let (start, end) = (skip.start.max(tile.start), skip.end.min(tile.end));
        if start < end {
            let mut skipped = sum.narrow(1, int(start - tile.start), int(end - start));
            let _ = skipped.fill_(f64::INFINITY);
        }
        sum
    }

    /// How far centring in single precision may have moved the distance of each row to any row in
    /// `tile` of `others`: U (‖x‖ + ‖y‖) per modality.
    pub(super) fn reach(&self, others: &Self, scale: &[f64; 3], tile: &Range<usize>) -> Vec<f64> {
        let mut reach = vec![0.0; self.0[0].norms.len()];
        for (i, scale) in scale.iter().enumerate() {
            let norms = &others.0[i].norms[tile.clone()];
            let farthest = norms.iter().fold(0.0, |a: f64, b| a.max(*b));
            for (reach, norm) in reach.iter_mut().zip(&self.0[i].norms) {
                *reach += 1.01 * U * scale * (norm + farthest);
            }
        }
        reach
    }
}

/// A lower bound above this rules out a distance of at most `distance`.
pub(super) fn limit(distance: f64, reach: f64) -> f64 {
    (distance + reach) * (1.0 + SLACK)
}

/// The mean of the rows, rounded to single precision: any centre is right, a central one is good.
pub(super) fn centre(values: &[f32], width: usize) -> Vec<f32> {
    let mut sum = vec![0f64; width];
    for row in values.chunks(width) {
        for (sum, x) in sum.iter_mut().zip(row) {
            *sum += f64::from(*x);
        }
    }
    #[expect(clippy::cast_precision_loss, reason = "far fewer rows than 2^52")]
    let count = (values.len() / width).max(1) as f64;
    #[expect(clippy::cast_possible_truncation, reason = "any centre is right")]
    sum.iter().map(|sum| (sum / count) as f32).collect()
}
