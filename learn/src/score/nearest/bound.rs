//! The filter: lower bounds of distances from single-precision matrix products, with a proven
//! margin. Knows nothing of which distances win.

use crate::score::features::Features;
use crate::score::similarity::{Kind, Metric, to_unit};

/// Unit roundoff of single precision.
const U: f64 = 5.960_464_477_539_063e-8;
/// More than the relative rounding of the roots, factors and sums that follow the products.
const SLACK: f64 = 16.0 * U;
/// More than what products below the range of single precision lose; far below any distance that
/// is told apart.
const UNDERFLOW: f64 = 1e-32;

/// What brings rows into the filter's frame: any centre is right, a central one is good.
pub(super) struct Frame {
    metric: Metric,
    centre: [Vec<f32>; 3],
}

/// One modality's rows in the frame: centred, for angles centred unit vectors.
pub(super) struct Framed {
    /// Row-major.
    pub(super) rows: Vec<f32>,
    /// Per row ‖x‖² less the margin ε ‖x‖² that makes the product a lower bound.
    pub(super) squares: Vec<f32>,
    /// Per row, how far bringing it here may have moved it.
    pub(super) moved: Vec<f64>,
}

impl Frame {
    /// The frame whose centre is the mean of `features`.
    pub(super) fn new(features: &Features, metric: Metric) -> Self {
        let centre = |modality: usize| {
            let width = features.widths()[modality];
            let mut sum = vec![0f64; width];
            for row in features.values(modality).chunks(width) {
                let factor = if metric.kind == Kind::Angular { to_unit(row) } else { 1.0 };
                for (sum, x) in sum.iter_mut().zip(row) {
                    *sum += f64::from(*x) * factor;
                }
            }
            #[expect(clippy::cast_precision_loss, reason = "far fewer rows than 2^52")]
            let count = features.count().max(1) as f64;
            sum.iter().map(|sum| single(sum / count)).collect()
        };
        Self { metric, centre: [0, 1, 2].map(centre) }
    }

    /// Rows `from..to` of `modality`.
    pub(super) fn apply(&self, features: &Features, modality: usize, (from, to): (usize, usize)) -> Framed {
        let centre = &self.centre[modality];
        let width = centre.len();
        let values = &features.values(modality)[from * width..to * width];
        let mut rows = Vec::with_capacity(values.len());
        match self.metric.kind {
            Kind::Euclidean => {
                values.chunks_exact(width).for_each(|row| rows.extend(row.iter().zip(centre).map(|(x, c)| x - c)));
            }
            Kind::Angular => values.chunks_exact(width).for_each(|row| {
                let factor = to_unit(row);
                rows.extend(row.iter().zip(centre).map(|(x, c)| single(f64::from(*x) * factor) - c));
            }),
        }
        // The product errs by at most γ(d) · 2 ‖x‖ ‖y‖ ≤ γ(d) (‖x‖² + ‖y‖²), γ(n) ≈ n U, whatever the
        // order of its additions; the squares, in eight lanes, by γ(d / 8 + 8) of each; rounding
        // them and adding the three by less than 5 U (‖x‖² + ‖y‖²).
        #[expect(clippy::cast_precision_loss, reason = "a feature's width is small")]
        let epsilon = 1.5 * U * (width as f64 + 16.0);
        let squares: Vec<f64> = rows.chunks_exact(width).map(square).collect();
        // Centring errs by U of every difference, the unit vector by U of every value, at most 1 in
        // all.
        let unit = if self.metric.kind == Kind::Angular { 1.0 } else { 0.0 };
        Framed {
            moved: squares.iter().map(|square| 1.01 * U * (square.sqrt() + unit)).collect(),
            squares: squares.iter().map(|square| single(square * (1.0 - epsilon) - UNDERFLOW)).collect(),
            rows,
        }
    }

    /// How far the distance of two rows may have been changed by bringing them here, if that moved
    /// them by at most `moved` in all, per modality.
    pub(super) fn reach(&self, moved: [f64; 3]) -> f64 {
        let scaled = moved.iter().zip(&self.metric.scale);
        match self.metric.kind {
            // |‖x′ − y′‖ − ‖x − y‖| ≤ r.
            Kind::Euclidean => scaled.map(|(r, scale)| r * scale).sum(),
            // ‖u′ − v′‖² / 2 ≤ (‖u − v‖ + r)² / 2, and ‖u − v‖ ≤ 2.
            Kind::Angular => scaled.map(|(r, scale)| (2.0 + r) * r * scale).sum(),
        }
    }

    /// Adds one modality's lower bounds of the scaled distances to `bounds`, one row against many:
    /// `products` are −2 x·y, `squares` those of the many, `square` the one's.
    pub(super) fn add(&self, modality: usize, (products, squares, square): (&[f32], &[f32], f32), bounds: &mut [f32]) {
        let scale = single(self.metric.scale[modality]);
        let terms = bounds.iter_mut().zip(products.iter().zip(squares));
        match self.metric.kind {
            Kind::Euclidean => terms.for_each(|(bound, (p, y))| *bound += scale * positive(p + y + square).sqrt()),
            Kind::Angular => {
                let half = scale / 2.0;
                terms.for_each(|(bound, (p, y))| *bound += half * positive(p + y + square));
            }
        }
    }
}

/// A lower bound above this rules out a distance of at most `distance`.
pub(super) fn limit(distance: f64, reach: f64) -> f32 {
    single((distance + reach) * (1.0 + SLACK)).next_up()
}

fn positive(x: f32) -> f32 {
    if x > 0.0 { x } else { 0.0 }
}

/// ‖row‖².
fn square(row: &[f32]) -> f64 {
    let mut lanes = [0f32; 8];
    let (chunks, rest) = row.as_chunks::<8>();
    for chunk in chunks {
        for lane in 0..8 {
            lanes[lane] += chunk[lane] * chunk[lane];
        }
    }
    for (lane, x) in lanes.iter_mut().zip(rest) {
        *lane += x * x;
    }
    lanes.iter().map(|lane| f64::from(*lane)).sum()
}

#[expect(clippy::cast_possible_truncation, reason = "the rounding is in the margins")]
fn single(x: f64) -> f32 {
    x as f32
}
