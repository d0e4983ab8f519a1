//! The filter's frame and the margins that make its bounds proven. Independent of tiles and of
//! the choice of the nearest.

use tch::Tensor;

use crate::lanes::{Lanes, WIDE};
use crate::metric::{Distance, Metric, to_unit};
use crate::points::Points;
use crate::tensor::{int, rows};

/// Unit roundoff of single precision.
pub(crate) const U: f64 = 5.960_464_477_539_063e-8;
/// Upper bound of the relative rounding of the roots, factors and sums that follow the products.
const SLACK: f64 = 16.0 * U;
/// Upper bound of the loss of products below the range of single precision; far below any distance that is
/// distinguished.
pub(crate) const UNDERFLOW: f64 = 1e-32;
/// A smaller factor counts as zero.
const LEAST_FACTOR: f64 = 1e-30;

/// The transformation of rows into the filter's frame: any centre is correct, a central one is fast.
pub(crate) struct Frame {
    kind: Distance,
    centre: [Vec<f32>; 3],
    /// The same centres, padded with zeros.
    lanes: [Vec<Lanes<f32>>; 3],
}

/// One part's rows in the frame: centred, for angles centred unit vectors.
pub(crate) struct Framed {
    /// `[N, d]`.
    pub(crate) rows: Tensor,
    /// Upper bound of the values' magnitudes.
    pub(crate) largest: f64,
    /// Upper bound of the distance of any row from its exact position.
    pub(crate) moved: f64,
}

impl Framed {
    /// A framed `rows`; `moved` maps an upper bound of ‖x‖ to the error of the rows.
    pub(crate) fn new(rows: Tensor, moved: impl Fn(f64) -> f64) -> Self {
        let mut framed = Self { rows, largest: 0.0, moved: 0.0 };
        if framed.count() > 0 {
            let (least, most) = framed.rows.aminmax(None, false);
            framed.largest = most.double_value(&[]).max(-least.double_value(&[]));
        }
        framed.moved = moved(framed.longest());
        framed
    }

    /// Upper bound of ‖x‖.
    pub(crate) fn longest(&self) -> f64 {
        #[expect(clippy::cast_precision_loss, reason = "a feature's width is small")]
        let width = self.width() as f64;
        self.largest * width.sqrt() * 1.001
    }

    pub(crate) fn width(&self) -> usize {
        usize::try_from(self.rows.size()[1]).unwrap_or_default()
    }

    pub(crate) fn count(&self) -> usize {
        usize::try_from(self.rows.size()[0]).unwrap_or_default()
    }
}

/// Per row ‖x‖², in any order of additions: the error is below γ(d + 4), γ(n) ≈ n U.
pub(crate) fn squares(rows: &Tensor) -> Tensor {
    rows.norm_scalaropt_dim(2.0, [1i64].as_slice(), false).square_()
}

/// `squares` less the margin ε ‖x‖² that makes the product a lower bound, times `factor` (which is at most 1 for
/// values, so that no value below single precision becomes large).
///
/// The product errs by at most γ(d) · 2 ‖x‖ ‖y‖ ≤ γ(d) (‖x‖² + ‖y‖²), whatever the order of its
/// additions; the squares by γ(d + 4) of each; the factors, and adding the three, by less than
/// 10 U (‖x‖² + ‖y‖²).
pub(crate) fn shrunk(squares: &Tensor, width: usize, factor: f64) -> Tensor {
    (squares * (margin(width) * factor)).g_sub_scalar_(UNDERFLOW)
}

/// 1 − ε for rows of `width` values.
pub(crate) fn margin(width: usize) -> f64 {
    #[expect(clippy::cast_precision_loss, reason = "a feature's width is small")]
    let width = width as f64;
    1.0 - 2.5 * U * (width + 16.0)
}

impl Frame {
    /// The frame whose centre is the mean of `features`.
    pub(crate) fn new(features: &Points, kind: Distance) -> Self {
        let centre = |part: usize| {
            let width = features.widths()[part];
            let mut sum = vec![0f64; width];
            for row in (0..features.count()).map(|at| features.row(part, at)) {
                let factor = if kind == Distance::Angular { to_unit(row) } else { 1.0 };
                for (sum, x) in sum.iter_mut().zip(row) {
                    *sum += f64::from(*x) * factor;
                }
            }
            #[expect(clippy::cast_precision_loss, reason = "far fewer rows than 2^52")]
            let count = features.count().max(1) as f64;
            sum.iter().map(|sum| single(sum / count)).collect()
        };
        let centre = [0, 1, 2].map(centre);
        let padded = |values: &[f32]| Lanes(std::array::from_fn(|i| values.get(i).copied().unwrap_or_default()));
        let lanes = centre.each_ref().map(|centre: &Vec<f32>| centre.chunks(WIDE).map(padded).collect());
        Self { kind, centre, lanes }
    }

    /// The centre of `part`, padded with zeros.
    pub(crate) fn lanes(&self, part: usize) -> &[Lanes<f32>] {
        &self.lanes[part]
    }

    /// Row `at` of `part` before centring: for angles its unit vector, written to `unit`.
    pub(crate) fn row<'a>(
        &self,
        features: &'a Points,
        (part, at): (usize, usize),
        unit: &'a mut Vec<f32>,
    ) -> &'a [f32] {
        let row = features.row(part, at);
        if self.kind == Distance::Euclidean {
            return row;
        }
        let factor = to_unit(row);
        unit.clear();
        unit.extend(row.iter().map(|x| single(f64::from(*x) * factor)));
        unit
    }

    /// Upper bound of the distance from its exact position of a row whose norm in the frame is at most `norm`.
    pub(crate) fn moved(&self, norm: f64) -> f64 {
        // Centring errs by U of every difference, a unit vector by U of every value: 1 in all.
        let unit = if self.kind == Distance::Angular { 1.0 } else { 0.0 };
        1.01 * U * (norm + unit)
    }

    /// The rows of `part` of the points numbered `at`.
    pub(crate) fn apply(&self, features: &Points, part: usize, at: impl Iterator<Item = usize>) -> Framed {
        Framed::new(self.rows(features, part, at), |norm| self.moved(norm))
    }

    /// As [`Self::apply`], without what it measures: `[N, d]`.
    pub(crate) fn rows(&self, features: &Points, part: usize, at: impl Iterator<Item = usize>) -> Tensor {
        let centre = &self.centre[part];
        let (mut values, mut unit) = (Vec::with_capacity(at.size_hint().0 * centre.len()), Vec::new());
        for at in at {
            values.extend_from_slice(self.row(features, (part, at), &mut unit));
        }
        let mut placed = rows(&values, centre.len());
        let _ = placed.g_sub_(&Tensor::from_slice(centre).view([1, int(centre.len())]));
        placed
    }
}

/// The factor of squared distances of `part` that leaves them (angles) or their roots (Euclidean) to be added up, for
/// rows whose distances may have grown by the factor `stretch`. Where single precision could not hold it, the factor is
/// 0, which also gives a lower bound.
pub(crate) fn factor(metric: &Metric, part: usize, stretch: f64) -> f64 {
    let scale = metric.scale[part];
    let factor = match metric.kind {
        Distance::Euclidean => (scale / stretch).powi(2),
        Distance::Angular => scale / (2.0 * stretch * stretch),
    };
    if factor > LEAST_FACTOR { factor } else { 0.0 }
}

/// Turns the products −2 x·y, given the summands of each column and of each row, into lower bounds.
pub(crate) fn finish(kind: Distance, products: &mut Tensor, columns: &Tensor, rows: &Tensor) {
    let _ = products.g_add_(columns).g_add_(rows).relu_();
    if kind == Distance::Euclidean {
        let _ = products.sqrt_();
    }
}

/// A lower bound above this rules out a distance of at most `distance` between rows that were moved
/// by at most `moved` in all, per part.
pub(crate) fn limit(metric: &Metric, moved: [f64; 3], distance: f64) -> f32 {
    let scaled = moved.iter().zip(&metric.scale);
    let reach: f64 = match metric.kind {
        // |‖x′ − y′‖ − ‖x − y‖| ≤ r.
        Distance::Euclidean => scaled.map(|(r, scale)| r * scale).sum(),
        // ‖u′ − v′‖² / 2 ≤ (‖u − v‖ + r)² / 2, and scale ‖u − v‖² / 2 ≤ distance.
        Distance::Angular => scaled.map(|(r, scale)| ((2.0 * distance * scale).sqrt() + r * scale / 2.0) * r).sum(),
    };
    single((distance + reach) * (1.0 + SLACK)).next_up()
}

#[expect(clippy::cast_possible_truncation, reason = "the rounding is in the margins")]
fn single(x: f64) -> f32 {
    x as f32
}
