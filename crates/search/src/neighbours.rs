//! The k nearest points of other groups, in single precision: for means over neighbours, which need no exact
//! neighbours.

use tch::{Kind, Tensor};

use crate::metric::{Distance, Metric, to_unit};
use crate::points::{PARTS, Points};
use crate::tensor::{int, rows};

/// Upper bound of the number of distances that are in memory at a time, unless one point has more.
const DISTANCES: usize = 1 << 24;

/// Groups of points, prepared for the search around each point.
pub struct Neighbours {
    parts: [Part; PARTS],
    windows: Windows,
    /// First point of each group, and the number of points as the last entry.
    bounds: Vec<usize>,
    kind: Distance,
}

/// One part of all points.
struct Part {
    /// `[R, width]`: the rows that the points are made of, scaled so that distances need no factor.
    rows: Tensor,
    /// `[N]`: per window, the factor that makes it a unit vector; `None` where distances are not those of angles, and where
    /// the rows are such vectors themselves.
    units: Option<Tensor>,
    /// `[N]`: the squares of points.
    squares: Tensor,
}

impl Part {
    fn new((points, windows): (&Points, &Windows), part: usize, metric: &Metric) -> Self {
        #[expect(clippy::cast_possible_truncation, reason = "single precision is enough here")]
        let scale = match metric.kind {
            Distance::Euclidean => metric.scale[part],
            // The distance is half of the square.
            Distance::Angular => (metric.scale[part] / 2.0).sqrt(),
        } as f32;
        let mut rows = rows(points.values(part), points.shape().widths[part]) * f64::from(scale);
        let mut units = (metric.kind == Distance::Angular).then(|| {
            let units = (0..points.count()).map(|at| to_unit(points.row(part, at)));
            Tensor::from_slice(&units.collect::<Vec<f64>>()).to_kind(Kind::Float).clamp_max(f64::from(f32::MAX))
        });
        if windows.length == 1
            && let Some(units) = units.take()
        {
            rows *= units.unsqueeze(1);
        }
        let squares = if let Some(units) = &units {
            // Those of unit vectors, and of zeros.
            units.sign() * f64::from(scale).powi(2)
        } else {
            let squares = rows.square().sum_dim_intlist([1i64].as_slice(), false, Kind::Float);
            windows.sums(squares, (0, points.count()), Axes::Rows)
        };
        Self { rows, units, squares }
    }

    /// The distances, or their squares, between points `from..to` and all points: `[to − from, N]`.
    fn distances(&self, windows: &Windows, (from, to): (usize, usize)) -> Tensor {
        let (first, count) = windows.rows((from, to));
        let products = self.rows.narrow(0, first, count).matmul(&self.rows.tr());
        let mut products = windows.sums(products, (from, to), Axes::Both);
        let some = |all: &Tensor| all.narrow(0, int(from), int(to - from)).unsqueeze(1);
        if let Some(units) = &self.units {
            let _ = products.g_mul_(units).g_mul_(&some(units));
        }
        some(&self.squares) + &self.squares - products.g_mul_scalar_(2.0)
    }
}

/// Which rows each point has.
struct Windows {
    /// The first row of each point.
    starts: Vec<i64>,
    /// Rows a point.
    length: i64,
}

/// The dimensions of values that are of rows.
#[derive(Clone, Copy, PartialEq)]
enum Axes {
    /// The first.
    Rows,
    /// The first, and the second, which has all rows.
    Both,
}

impl Windows {
    fn new(points: &Points) -> Self {
        let starts = (0..points.count()).map(|at| int(points.first_row(at))).collect();
        Self { starts, length: int(points.shape().length) }
    }

    /// The rows of points `from..to`: the first, and their number.
    fn rows(&self, (from, to): (usize, usize)) -> (i64, i64) {
        (self.starts[from], self.starts[to - 1] + self.length - self.starts[from])
    }

    /// The values of points `from..to`: the sums of those of their rows, given those of [`Self::rows`].
    fn sums(&self, of_rows: Tensor, (from, to): (usize, usize), axes: Axes) -> Tensor {
        if self.length == 1 || from == to {
            return of_rows;
        }
        let shifted = |by: i64| {
            let rest = |dimension: usize| of_rows.size()[dimension] - self.length + 1;
            let rows = of_rows.narrow(0, by, rest(0));
            if axes == Axes::Both { rows.narrow(1, by, rest(1)) } else { rows }
        };
        let mut sums = shifted(0).copy();
        for by in 1..self.length {
            let _ = sums.g_add_(&shifted(by));
        }
        let sums = sums.index_select(0, &(Tensor::from_slice(&self.starts[from..to]) - self.starts[from]));
        if axes == Axes::Both { sums.index_select(1, &Tensor::from_slice(&self.starts)) } else { sums }
    }
}

impl Neighbours {
    /// The search over `groups`, which have the same shape, under `metric`. Points are numbered through all groups,
    /// from 0.
    pub fn new(groups: &[&Points], metric: Metric) -> Self {
        let (points, bounds) = Points::joined(groups.iter().copied());
        let windows = Windows::new(&points);
        let parts = [0, 1, 2].map(|part| Part::new((&points, &windows), part, &metric));
        Self { parts, windows, bounds, kind: metric.kind }
    }

    /// The numbers of the `most` nearest points of other groups, for each point of `group`; unordered, and fewer if the
    /// other groups have fewer.
    pub fn nearest(&self, group: usize, most: usize) -> Vec<Vec<usize>> {
        let (begin, end) = (self.bounds[group], self.bounds[group + 1]);
        let all = self.windows.starts.len();
        let wanted = most.min(all - (end - begin));
        if wanted == 0 || begin == end {
            return vec![Vec::new(); end - begin];
        }
        let at_once = (DISTANCES / all).max(1);
        let near = |from: usize| {
            let some = (from, end.min(from + at_once));
            let of = |part: usize| {
                let square = self.parts[part].distances(&self.windows, some);
                match self.kind {
                    Distance::Euclidean => square.clamp_min(0.0).sqrt(),
                    Distance::Angular => square,
                }
            };
            let distances = of(0) + of(1) + of(2);
            let _own = distances.narrow(1, int(begin), int(end - begin)).fill_(f64::INFINITY);
            let (_, nearest) = distances.topk(int(wanted), 1, false, true);
            Vec::<i64>::try_from(nearest.flatten(0, -1)).unwrap_or_default()
        };
        let nearest: Vec<i64> = (begin..end).step_by(at_once).flat_map(near).collect();
        let number = |place: &i64| usize::try_from(*place).ok();
        nearest.chunks(wanted).map(|near| near.iter().filter_map(number).collect()).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::points::PointShape;

    fn line(places: &[f32]) -> Points {
        Points::new([places.to_vec(), vec![0.0; places.len()], vec![0.0; places.len()]], [1; PARTS]).unwrap()
    }

    #[test]
    fn neighbours_are_the_nearest_points_of_other_groups() {
        let metric = Metric { kind: Distance::Euclidean, scale: [1.0; PARTS] };
        let neighbours = Neighbours::new(&[&line(&[0.0, 10.0]), &line(&[1.0, 2.0, 11.0]), &line(&[9.0])], metric);
        let mut nearest = neighbours.nearest(0, 2);
        nearest.iter_mut().for_each(|near| near.sort_unstable());
        assert_eq!(nearest, [[2, 3], [4, 5]]);
        assert_eq!(neighbours.nearest(2, 9)[0].len(), 5, "all there are");
        assert_eq!(Neighbours::new(&[&line(&[0.0, 1.0])], metric).nearest(0, 3), [[0usize; 0]; 2]);
    }

    /// Fewer rows than a window has.
    fn points_of_no_window() -> Points {
        let shape = PointShape { widths: [5, 2, 3], length: 4 };
        Points::new([vec![1.0; 10], vec![1.0; 4], vec![1.0; 6]], shape).unwrap()
    }

    #[test]
    fn neighbours_of_windows_are_those_of_points_with_the_same_values() {
        let (windows, points) = crate::testing::windows(&[30, 3, 41, 9], [5, 2, 3], 4);
        for kind in [Distance::Euclidean, Distance::Angular] {
            let metric = Metric { kind, scale: [1.0, 0.5, 2.0] };
            let [found, expected] =
                [&windows, &points].map(|groups| Neighbours::new(&groups.iter().collect::<Vec<_>>(), metric));
            let nothing = Neighbours::new(&[&Points::empty(windows[0].shape()), &points_of_no_window()], metric);
            assert_eq!((nothing.nearest(0, 5), nothing.nearest(1, 5)), (Vec::new(), Vec::new()));
            for group in 0..windows.len() {
                let [mut found, mut expected] = [&found, &expected].map(|all| all.nearest(group, 5));
                found.iter_mut().chain(&mut expected).for_each(|near| near.sort_unstable());
                assert_eq!(found, expected);
            }
        }
    }
}
