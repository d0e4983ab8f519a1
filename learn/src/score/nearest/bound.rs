//! The filter: lower bounds of distances from single-precision matrix products, with a proven
//! margin. Knows nothing of which distances win.

use crate::score::features::Features;
use crate::score::similarity::{Kind, Metric, to_unit};

/// Unit roundoff of single precision.
pub(super) const U: f64 = 5.960_464_477_539_063e-8;
/// More than the relative rounding of the roots, factors and sums that follow the products.
const SLACK: f64 = 16.0 * U;
/// More than what products below the range of single precision lose; far below any distance that
/// is told apart.
const UNDERFLOW: f64 = 1e-32;

/// What brings rows into the filter's frame: any centre is right, a central one is good.
pub(super) struct Frame {
    kind: Kind,
    centre: [Vec<f32>; 3],
}

/// One modality's rows in the frame: centred, for angles centred unit vectors.
pub(super) struct Framed {
    /// Row-major.
    pub(super) rows: Vec<f32>,
    /// Values a row.
    pub(super) width: usize,
    /// Per row ‖x‖².
    pub(super) squares: Vec<f64>,
    /// Per row, how far it may lie from where it should.
    pub(super) moved: Vec<f64>,
}

impl Framed {
    /// `rows` of which row by row `moved` gives the error from ‖x‖.
    pub(super) fn new(rows: Vec<f32>, width: usize, moved: impl Fn(usize, f64) -> f64) -> Self {
        let squares: Vec<f64> = rows.chunks_exact(width).map(square).collect();
        let moved = squares.iter().enumerate().map(|(row, square)| moved(row, square.sqrt())).collect();
        Self { rows, width, squares, moved }
    }

    /// Per row ‖x‖² less the margin ε ‖x‖² that makes the product a lower bound.
    ///
    /// The product errs by at most γ(d) · 2 ‖x‖ ‖y‖ ≤ γ(d) (‖x‖² + ‖y‖²), γ(n) ≈ n U, whatever the
    /// order of its additions; the squares, in eight lanes, by γ(d / 8 + 8) of each; rounding them
    /// and adding the three by less than 5 U (‖x‖² + ‖y‖²).
    pub(super) fn shrunk(&self) -> Vec<f32> {
        #[expect(clippy::cast_precision_loss, reason = "a feature's width is small")]
        let epsilon = 1.5 * U * (self.width as f64 + 16.0);
        self.squares.iter().map(|square| single(square * (1.0 - epsilon) - UNDERFLOW)).collect()
    }
}

impl Frame {
    /// The frame whose centre is the mean of `features`.
    pub(super) fn new(features: &Features, kind: Kind) -> Self {
        let centre = |modality: usize| {
            let width = features.widths()[modality];
            let mut sum = vec![0f64; width];
            for row in features.values(modality).chunks(width) {
                let factor = if kind == Kind::Angular { to_unit(row) } else { 1.0 };
                for (sum, x) in sum.iter_mut().zip(row) {
                    *sum += f64::from(*x) * factor;
                }
            }
            #[expect(clippy::cast_precision_loss, reason = "far fewer rows than 2^52")]
            let count = features.count().max(1) as f64;
            sum.iter().map(|sum| single(sum / count)).collect()
        };
        Self { kind, centre: [0, 1, 2].map(centre) }
    }

    /// Rows `from..to` of `modality`.
    pub(super) fn apply(&self, features: &Features, modality: usize, (from, to): (usize, usize)) -> Framed {
        let centre = &self.centre[modality];
        let width = centre.len();
        let values = &features.values(modality)[from * width..to * width];
        let mut rows = Vec::with_capacity(values.len());
        match self.kind {
            Kind::Euclidean => {
                values.chunks_exact(width).for_each(|row| rows.extend(row.iter().zip(centre).map(|(x, c)| x - c)));
            }
            Kind::Angular => values.chunks_exact(width).for_each(|row| {
                let factor = to_unit(row);
                rows.extend(row.iter().zip(centre).map(|(x, c)| single(f64::from(*x) * factor) - c));
            }),
        }
        // Centring errs by U of every difference, a unit vector by U of every value: 1 in all.
        let unit = if self.kind == Kind::Angular { 1.0 } else { 0.0 };
        Framed::new(rows, width, |_, norm| 1.01 * U * (norm + unit))
    }
}

/// How far the distance of two rows may have been changed if they were moved by at most `moved` in
/// all, per modality.
pub(super) fn reach(metric: &Metric, moved: [f64; 3]) -> f64 {
    let scaled = moved.iter().zip(&metric.scale);
    match metric.kind {
        // |‖x′ − y′‖ − ‖x − y‖| ≤ r.
        Kind::Euclidean => scaled.map(|(r, scale)| r * scale).sum(),
        // ‖u′ − v′‖² / 2 ≤ (‖u − v‖ + r)² / 2, and ‖u − v‖ ≤ 2.
        Kind::Angular => scaled.map(|(r, scale)| (2.0 + r) * r * scale).sum(),
    }
}

/// The factor of modality `modality` in [`add`], for rows whose distances may have grown by the
/// factor `stretch`.
pub(super) fn factor(metric: &Metric, modality: usize, stretch: f64) -> f32 {
    let scale = metric.scale[modality];
    match metric.kind {
        Kind::Euclidean => single(scale / stretch),
        Kind::Angular => single(scale / (2.0 * stretch * stretch)),
    }
}

/// Adds one modality's lower bounds of the scaled distances to `bounds`, one row against many:
/// `products` are −2 x·y, `squares` those of the many, `square` the one's.
pub(super) fn add((kind, factor): (Kind, f32), (products, squares, square): (&[f32], &[f32], f32), bounds: &mut [f32]) {
    let terms = bounds.iter_mut().zip(products.iter().zip(squares));
    match kind {
        Kind::Euclidean => terms.for_each(|(bound, (p, y))| *bound += factor * positive(p + y + square).sqrt()),
        Kind::Angular => terms.for_each(|(bound, (p, y))| *bound += factor * positive(p + y + square)),
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
