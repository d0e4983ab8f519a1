//! The k nearest points of other groups, in single precision: for means over neighbours, which need no exact
//! neighbours.

use tch::{Kind, Tensor};

use crate::metric::{Distance, Metric, to_unit};
use crate::points::{PARTS, Points};
use crate::tensor::{int, rows};

/// Groups of points, prepared for the search around each point.
pub struct Neighbours {
    /// Per part `[N, width]`, scaled so that distances need no factor.
    rows: [Tensor; PARTS],
    /// Per part `[N]`.
    squares: [Tensor; PARTS],
    /// First point of each group, and the number of points as the last entry.
    bounds: Vec<usize>,
    kind: Distance,
}

impl Neighbours {
    /// The search over `groups`, which have the same widths, under `metric`. Points are numbered through all groups,
    /// from 0.
    pub fn new(groups: &[Points], metric: Metric) -> Self {
        let widths = groups.first().map_or([1; PARTS], Points::widths);
        let matrix = |part: usize| {
            #[expect(clippy::cast_possible_truncation, reason = "single precision is enough here")]
            let scale = match metric.kind {
                Distance::Euclidean => metric.scale[part],
                // The distance is half of the square.
                Distance::Angular => (metric.scale[part] / 2.0).sqrt(),
            } as f32;
            let all: Vec<f32> = groups.iter().flat_map(|points| points.values(part)).copied().collect();
            let z = rows(&all, widths[part]) * f64::from(scale);
            match metric.kind {
                Distance::Euclidean => z,
                Distance::Angular => {
                    let units = groups
                        .iter()
                        .flat_map(|points| (0..points.count()).map(move |row| to_unit(points.row(part, row))));
                    z * Tensor::from_slice(&units.collect::<Vec<f64>>()).to_kind(Kind::Float).unsqueeze(1)
                }
            }
        };
        let rows = [0, 1, 2].map(matrix);
        let squares = [0, 1, 2].map(|i: usize| rows[i].square().sum_dim_intlist([1i64].as_slice(), false, Kind::Float));
        let counts = groups.iter().scan(0, |total, points| {
            *total += points.count();
            Some(*total)
        });
        Self { squares, rows, bounds: std::iter::once(0).chain(counts).collect(), kind: metric.kind }
    }

    /// The numbers of the `most` nearest points of other groups, for each point of `group`; unordered, and fewer if the
    /// other groups have fewer.
    pub fn nearest(&self, group: usize, most: usize) -> Vec<Vec<usize>> {
        let (begin, end) = (self.bounds[group], self.bounds[group + 1]);
        let wanted = most.min(self.bounds[self.bounds.len() - 1] - (end - begin));
        if wanted == 0 || begin == end {
            return vec![Vec::new(); end - begin];
        }
        let (begin, end) = (int(begin), int(end));
        let of = |part: usize| {
            let (rows, squares) = (&self.rows[part], &self.squares[part]);
            let products = rows.narrow(0, begin, end - begin).matmul(&rows.tr());
            let square = squares.narrow(0, begin, end - begin).unsqueeze(1) + squares - products * 2.0;
            match self.kind {
                Distance::Euclidean => square.clamp_min(0.0).sqrt(),
                Distance::Angular => square,
            }
        };
        let distances = of(0) + of(1) + of(2);
        let _own = distances.narrow(1, begin, end - begin).fill_(f64::INFINITY);
        let (_, nearest) = distances.topk(int(wanted), 1, false, true);
        let nearest: Vec<i64> = Vec::try_from(nearest.flatten(0, -1)).unwrap_or_default();
        let number = |place: &i64| usize::try_from(*place).ok();
        nearest.chunks(wanted).map(|near| near.iter().filter_map(number).collect()).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(places: &[f32]) -> Points {
        Points::new([places.to_vec(), vec![0.0; places.len()], vec![0.0; places.len()]], [1; PARTS]).unwrap()
    }

    #[test]
    fn neighbours_are_the_nearest_points_of_other_groups() {
        let metric = Metric { kind: Distance::Euclidean, scale: [1.0; PARTS] };
        let neighbours = Neighbours::new(&[line(&[0.0, 10.0]), line(&[1.0, 2.0, 11.0]), line(&[9.0])], metric);
        let mut nearest = neighbours.nearest(0, 2);
        nearest.iter_mut().for_each(|near| near.sort_unstable());
        assert_eq!(nearest, [[2, 3], [4, 5]]);
        assert_eq!(neighbours.nearest(2, 9)[0].len(), 5, "all there are");
        assert_eq!(Neighbours::new(&[line(&[0.0, 1.0])], metric).nearest(0, 3), [[0usize; 0]; 2]);
    }
}
