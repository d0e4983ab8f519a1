//! Features as one byte a value, with a bound of what the rounding changes: enough to show that a segment's match stays
//! as it is. Independent of files and of encoding.

use gleaner_search::{Distance, Match, Metric};

use super::Features;

/// The largest code.
const MOST: f32 = 127.0;
/// The part of a distance by which its computation in double precision can be wrong, with room to spare.
const ROUNDING: f64 = 1e-9;

/// Rounded features of an episode.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Codes {
    /// Per modality, row-major.
    pub(super) codes: [Vec<i8>; 3],
    /// Per modality, the value of a code of 1.
    pub(super) steps: [f32; 3],
    /// Per modality, the longest distance between a row and its codes.
    pub(super) moved: [f32; 3],
}

/// What codes say of features.
pub(in crate::score) struct Rough {
    points: Features,
    moved: [f64; 3],
}

impl Codes {
    pub(super) fn of(features: &Features) -> Self {
        let (mut codes, mut steps, mut moved) = ([const { Vec::new() }; 3], [0.0; 3], [0.0; 3]);
        for part in 0..3 {
            let values = features.values(part);
            let most = values.iter().fold(0f32, |most, value| most.max(value.abs()));
            let step = most / MOST;
            // Below this, the inverse of a step is not finite.
            let step = if step < f32::MIN_POSITIVE { 0.0 } else { step };
            #[expect(clippy::cast_possible_truncation, reason = "it is at most 127")]
            let code = |value: &f32| if step > 0.0 { (value / step).round().clamp(-MOST, MOST) as i8 } else { 0 };
            codes[part] = values.iter().map(code).collect();
            steps[part] = step;
            let row = |at: usize| {
                let width = features.widths()[part];
                let rounded = codes[part][at * width..(at + 1) * width].iter().map(|&code| value(code, step));
                let squares = features.row(part, at).iter().zip(rounded);
                squares.map(|(exact, rounded)| (f64::from(*exact) - f64::from(rounded)).powi(2)).sum::<f64>().sqrt()
            };
            let longest = (0..features.count()).map(row).fold(0f64, f64::max) * (1.0 + ROUNDING);
            #[expect(clippy::cast_possible_truncation, reason = "the next value above is taken")]
            let rounded_up = if longest > 0.0 { (longest as f32).next_up() } else { 0.0 };
            moved[part] = rounded_up;
        }
        Self { codes, steps, moved }
    }

    /// What these codes, of rows of these widths, say; `None` if they are of other rows or not finite.
    pub(super) fn rough(&self, count: usize, widths: [usize; 3]) -> Option<Rough> {
        let whole = |part: usize| self.codes[part].len() == count * widths[part];
        if !(0..3).all(whole) || self.moved.iter().any(|moved| !moved.is_finite() || *moved < 0.0) {
            return None;
        }
        let values = [0, 1, 2].map(|part| self.codes[part].iter().map(|&code| value(code, self.steps[part])).collect());
        Some(Rough { points: Features::new(values, widths).ok()?, moved: self.moved.map(f64::from) })
    }
}

/// The value of a code.
fn value(code: i8, step: f32) -> f32 {
    f32::from(code) * step
}

impl Rough {
    /// The rounded points.
    pub(in crate::score) fn points(&self) -> &Features {
        &self.points
    }

    /// Whether every exact point is farther from all points of an index than its known match, given the nearest of them to
    /// each rounded point.
    pub(in crate::score) fn stay(&self, known: &[Option<Match>], nearest: &[Match], metric: &Metric) -> bool {
        known.len() == nearest.len()
            && known.iter().zip(nearest).enumerate().all(|(row, (known, nearest))| {
                let least = nearest.distance - self.margin(row, metric) - ROUNDING * (1.0 + nearest.distance);
                known.is_some_and(|known| least > known.distance)
            })
    }

    /// By how much the distance of the exact row to any point can be below that of the rounded row.
    fn margin(&self, row: usize, metric: &Metric) -> f64 {
        let part = |part: usize| match (metric.kind, self.moved[part]) {
            (_, 0.0) => 0.0,
            (Distance::Euclidean, moved) => moved,
            // ‖u − û‖ ≤ 2 ‖x − x̂‖ / ‖x̂‖ and ‖u − û‖ ≤ 2 of unit vectors u, û; and for every unit vector v,
            // ‖u − v‖² / 2 ≥ (‖û − v‖ − ‖u − û‖)² / 2 ≥ ‖û − v‖² / 2 − 2 ‖u − û‖ (or is at least 0, which is no less).
            (Distance::Angular, moved) => {
                let length = self.points.row(part, row).iter().map(|x| f64::from(*x).powi(2)).sum::<f64>().sqrt();
                2.0 * (2.0 * moved / length).min(2.0)
            }
        };
        (0..3).map(|at| metric.scale[at] * part(at)).sum()
    }
}

#[cfg(test)]
mod tests {
    use gleaner_search::Index;

    use super::*;
    use crate::toy;

    fn features(seed: u64, count: usize) -> Features {
        let widths = [5, 3, 2];
        let of = |part: usize| {
            let size = [count * widths[part]].map(|size| i64::try_from(size).unwrap());
            crate::batch::values(&toy::numbers(&size, seed + part as u64))
        };
        Features::new([of(0), of(1), of(2)], widths).unwrap()
    }

    fn metrics() -> [Metric; 2] {
        [Distance::Euclidean, Distance::Angular].map(|kind| Metric { kind, scale: [1.0, 2.0, 0.5] })
    }

    #[test]
    fn no_distance_falls_by_more_than_the_margin() {
        let (exact, others) = (features(1, 40), features(9, 60));
        let rough = Codes::of(&exact).rough(40, exact.widths()).unwrap();
        for metric in metrics() {
            let distance = |a: &Features, row, other| metric.distance(metric.parts((a, row), (&others, other)));
            let mut tightest = f64::INFINITY;
            for row in 0..40 {
                for other in 0..60 {
                    let fell = distance(rough.points(), row, other) - distance(&exact, row, other);
                    assert!(fell <= rough.margin(row, &metric), "{fell} at {row}, {other}");
                    tightest = tightest.min(rough.margin(row, &metric));
                }
            }
            assert!(tightest < 0.3, "the margin says nothing: {tightest}");
        }
    }

    /// Points at every distance from the known match: those nearer are never taken to stay.
    #[test]
    fn a_segment_with_a_nearer_point_does_not_stay() {
        let (exact, others) = (features(1, 30), features(9, 50));
        for metric in metrics() {
            let index = Index::new(&[(0, &others)], metric).unwrap();
            let (mut stayed, mut moved) = (0, 0);
            for row in 0..30 {
                let one = Features::new([0, 1, 2].map(|part| exact.row(part, row).to_vec()), exact.widths()).unwrap();
                let rough = Codes::of(&one).rough(1, one.widths()).unwrap();
                let new = index.nearest(&one, None).unwrap().unwrap()[0];
                let nearest = index.nearest(rough.points(), None).unwrap().unwrap();
                for factor in [0.5, 0.9, 0.999, 1.0, 1.000_001, 1.1, 2.0] {
                    let known = Match { distance: new.distance * factor, ..new };
                    let stays = rough.stay(&[Some(known)], &nearest, &metric);
                    assert!(!stays || known.distance < new.distance, "{factor}");
                    (stayed, moved) = (stayed + usize::from(stays), moved + usize::from(!stays));
                }
                assert!(!rough.stay(&[None], &nearest, &metric));
            }
            assert!(stayed > 30 && moved >= 120, "{stayed} {moved}");
        }
    }

    #[test]
    fn zeros_and_the_least_values_are_kept_as_zeros() {
        let small = Features::new([vec![0.0, 0.0], vec![1e-42], vec![-3.0]], [2, 1, 1]).unwrap();
        let rough = Codes::of(&small).rough(1, small.widths()).unwrap();
        assert_eq!((rough.points().values(0), rough.points().values(2)), (&[0.0, 0.0][..], &[-3.0][..]));
        assert!(rough.moved[1] > 0.0 && rough.moved[0] == 0.0);
        assert!(Codes::of(&small).rough(2, small.widths()).is_none());
    }
}
