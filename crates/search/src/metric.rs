//! The comparison of two points: double precision, in a fixed order of additions, hence exact and repeatable.

use crate::points::{PARTS, Points};

/// The distance of two points in one part.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Distance {
    /// ‖x − y‖₂, in the unit of the values.
    Euclidean,
    /// 1 − cos(x, y), which is ‖u − v‖² / 2 for the unit vectors u, v of x, y: 0 for equal directions, at most 2. A
    /// zero vector has no direction and is used unchanged, so its distance is 0 to another zero vector and 1/2 to all
    /// others.
    Angular,
}

/// The distance of two points: the sum over their parts of `scale` times the part's distance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Metric {
    /// The distance in each part.
    pub kind: Distance,
    /// Factors of the parts' distances, finite and at least 0.
    pub scale: [f64; PARTS],
}

impl Metric {
    /// The distance in each part between a row of `a` and a row of `b`, before any scale.
    pub fn parts(&self, a: (&Points, usize), b: (&Points, usize)) -> [f64; PARTS] {
        std::array::from_fn(|part| {
            let (a, b) = (a.0.row(part, a.1), b.0.row(part, b.1));
            match self.kind {
                Distance::Euclidean => sum(a, b, |a, b| (a - b) * (a - b)).sqrt(),
                Distance::Angular => {
                    let (to_u, to_v) = (to_unit(a), to_unit(b));
                    sum(a, b, |a, b| (a * to_u - b * to_v) * (a * to_u - b * to_v)) / 2.0
                }
            }
        })
    }

    /// The scaled sum of `parts`.
    pub fn distance(&self, parts: [f64; PARTS]) -> f64 {
        let scaled = parts.iter().zip(&self.scale);
        scaled.map(|(part, scale)| part * scale).sum()
    }
}

/// The factor that makes `row` a unit vector; 0 for a zero vector.
pub(crate) fn to_unit(row: &[f32]) -> f64 {
    let norm = sum(row, row, |x, y| x * y).sqrt();
    if norm > 0.0 { 1.0 / norm } else { 0.0 }
}

/// Σ `term`(aᵢ, bᵢ) in eight interleaved lanes: a fixed order of additions that a processor can nevertheless vectorise.
fn sum(a: &[f32], b: &[f32], term: impl Fn(f64, f64) -> f64) -> f64 {
    let mut lanes = [0f64; 8];
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<8>(), b.as_chunks::<8>());
    for (a, b) in a.iter().zip(b) {
        for lane in 0..8 {
            lanes[lane] += term(f64::from(a[lane]), f64::from(b[lane]));
        }
    }
    for (lane, (a, b)) in lanes.iter_mut().zip(a_rest.iter().zip(b_rest)) {
        *lane += term(f64::from(*a), f64::from(*b));
    }
    lanes.iter().sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn features(o: [f32; 2], m: [f32; 2], a: [f32; 1]) -> Points {
        Points::new([o.to_vec(), m.to_vec(), a.to_vec()], [2, 2, 1]).unwrap()
    }

    fn parts(kind: Distance, a: &Points, b: &Points) -> [f64; 3] {
        let metric = Metric { kind, scale: [1.0; PARTS] };
        assert_eq!(metric.parts((a, 0), (b, 0)), metric.parts((b, 0), (a, 0)));
        metric.parts((a, 0), (b, 0))
    }

    #[test]
    fn euclidean_parts_are_the_distances_in_each_part() {
        let (a, b) = (features([1.0, 1.0], [0.0, 2.0], [5.0]), features([4.0, 5.0], [0.0, 2.0], [3.0]));
        assert_eq!(parts(Distance::Euclidean, &a, &b), [5.0, 0.0, 2.0]);
        let metric = Metric { kind: Distance::Euclidean, scale: [2.0, 1.0, 0.5] };
        assert_eq!(metric.distance([5.0, 0.0, 2.0]), 11.0);
    }

    #[test]
    fn angular_parts_are_one_less_the_cosine() {
        let (a, b) = (features([1.0, 0.0], [3.0, 4.0], [5.0]), features([0.0, 7.0], [6.0, 8.0], [-2.0]));
        let found = parts(Distance::Angular, &a, &b);
        for (found, expected) in found.iter().zip([1.0, 0.0, 2.0]) {
            assert!((found - expected).abs() < 1e-15, "{found} {expected}");
        }
        assert_eq!(parts(Distance::Angular, &a, &a), [0.0; 3]);
    }

    #[test]
    fn a_zero_vector_is_like_itself_and_half_like_anything_else() {
        let (zero, other) = (features([0.0; 2], [0.0; 2], [0.0]), features([3.0, 0.0], [0.0; 2], [1e-30]));
        assert_eq!(parts(Distance::Angular, &zero, &other), [0.5, 0.0, 0.5]);
        assert_eq!(parts(Distance::Euclidean, &zero, &other), [3.0, 0.0, f64::from(1e-30f32)]);
    }

    #[test]
    fn every_value_counts_whatever_the_width() {
        for width in [1usize, 7, 8, 9, 24, 31] {
            let (a, b) = (vec![2.0f32; width], vec![1.0f32; width]);
            let expected = f64::from(u32::try_from(width).unwrap());
            assert_eq!(sum(&a, &b, |a, b| a * a - b * 3.0), expected);
        }
    }
}
