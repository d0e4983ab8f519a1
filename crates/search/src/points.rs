//! Points as plain arrays, both those of an index and queries. Must not depend on the comparison of points.
//!
//! A point is one row, or a window of consecutive rows. Windows overlap, so every row is stored once.

use crate::error::SearchError;

/// Parts of a point.
pub const PARTS: usize = 3;
/// Upper bound of values, below which sums of squares do not overflow.
const LIMIT: f32 = 1e15;

/// The shape of a point: per part, `length` consecutive rows of `widths` values each.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PointShape {
    /// Values a row, per part.
    pub widths: [usize; PARTS],
    /// Rows a point, at least 1.
    pub length: usize,
}

impl From<[usize; PARTS]> for PointShape {
    /// Points of one row.
    fn from(widths: [usize; PARTS]) -> Self {
        Self { widths, length: 1 }
    }
}

impl PointShape {
    /// Values a point, per part.
    pub fn values(&self) -> [usize; PARTS] {
        self.widths.map(|width| width * self.length)
    }
}

/// N points: per part, rows in single precision, row-major. Parts may differ in width.
#[derive(Debug, Clone, PartialEq)]
pub struct Points {
    values: [Vec<f32>; PARTS],
    shape: PointShape,
    /// The first row of each point; empty for points of one row.
    starts: Vec<usize>,
}

impl Points {
    /// The points of these rows, the same number in every part: one for each row that has `length` − 1 rows before it.
    ///
    /// # Errors
    /// A width or the length is zero, the parts differ in their number of rows, or a value is not
    /// [comparable](Self::comparable).
    pub fn new(values: [Vec<f32>; PARTS], shape: impl Into<PointShape>) -> Result<Self, SearchError> {
        let shape = shape.into();
        if shape.widths.contains(&0) || shape.length == 0 {
            return Err(SearchError::new("shape", "has a zero; every part needs at least one value"));
        }
        let count = values[0].len() / shape.widths[0];
        if (0..PARTS).any(|i| values[i].len() != count * shape.widths[i]) {
            return Err(SearchError::new("values", "do not have the same number of rows in every part"));
        }
        let mut points = Self { starts: Vec::new(), values, shape };
        points.start(0);
        if !points.comparable() {
            return Err(SearchError::new("values", "must be finite and below 1e15"));
        }
        Ok(points)
    }

    /// No points, of this shape.
    pub fn empty(shape: impl Into<PointShape>) -> Self {
        Self { values: Default::default(), shape: shape.into(), starts: Vec::new() }
    }

    /// Appends the points of these rows, the same number in every part; no window spans earlier rows and these. Values are
    /// not checked; see [`Self::comparable`].
    pub fn extend<'a>(&mut self, rows: [impl AsRef<[f32]> + 'a; PARTS]) {
        let before = self.rows();
        for (all, rows) in self.values.iter_mut().zip(&rows) {
            all.extend_from_slice(rows.as_ref());
        }
        self.start(before);
    }

    /// Adds the windows of the rows from `first` on.
    fn start(&mut self, first: usize) {
        if self.shape.length > 1 {
            self.starts.extend(first..(self.rows() + 1).saturating_sub(self.shape.length).max(first));
        }
    }

    /// Appends the points of `other`, which has the same shape.
    pub(crate) fn append(&mut self, other: &Self) {
        let before = self.rows();
        for (all, rows) in self.values.iter_mut().zip(&other.values) {
            all.extend_from_slice(rows);
        }
        self.starts.extend(other.starts.iter().map(|start| before + start));
    }

    /// The points of all groups, which have the same shape, in their order; and the number of points before each group,
    /// then of all. A group without points may have any shape.
    pub(crate) fn joined<'a>(groups: impl Iterator<Item = &'a Self>) -> (Self, Vec<usize>) {
        let mut points = Self::empty([1; PARTS]);
        let mut bounds = vec![0];
        for group in groups {
            if points.count() == 0 {
                points.shape = group.shape;
            }
            if group.count() > 0 {
                points.append(group);
            }
            bounds.push(points.count());
        }
        (points, bounds)
    }

    /// Number of points N.
    pub fn count(&self) -> usize {
        if self.shape.length > 1 { self.starts.len() } else { self.rows() }
    }

    /// Number of rows.
    pub(crate) fn rows(&self) -> usize {
        self.values[0].len() / self.shape.widths[0].max(1)
    }

    /// The shape of each point.
    pub fn shape(&self) -> PointShape {
        self.shape
    }

    /// Values a point, per part.
    pub fn widths(&self) -> [usize; PARTS] {
        self.shape.values()
    }

    /// All values of `part`: its rows, each once.
    pub fn values(&self, part: usize) -> &[f32] {
        &self.values[part]
    }

    /// The values of `part` of point `at`, row-major.
    pub fn row(&self, part: usize, at: usize) -> &[f32] {
        let width = self.shape.widths[part];
        let start = self.first_row(at);
        &self.values[part][start * width..(start + self.shape.length) * width]
    }

    /// The number of the first row of point `at`.
    pub(crate) fn first_row(&self, at: usize) -> usize {
        if self.shape.length > 1 { self.starts[at] } else { at }
    }

    /// The rows of points `from..to` and all between them: the first, and the one after the last.
    pub(crate) fn rows_of(&self, (from, to): (usize, usize)) -> (usize, usize) {
        if from == to { (0, 0) } else { (self.first_row(from), self.first_row(to - 1) + self.shape.length) }
    }

    /// Whether every value is a number with a magnitude below 1e15. Distances of other points are not defined.
    pub fn comparable(&self) -> bool {
        self.values.iter().flatten().all(|value| value.abs() < LIMIT)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windows_share_their_rows_and_span_no_two_sequences() {
        let shape = PointShape { widths: [2, 1, 1], length: 3 };
        let rows = |from: u8, count: u8| {
            let line = |width: u8| (0..count * width).map(|i| f32::from(from + i)).collect::<Vec<_>>();
            [line(2), line(1), line(1)]
        };
        let mut points = Points::new(rows(0, 4), shape).unwrap();
        points.extend(rows(100, 2));
        points.extend(rows(50, 3));
        let mut all = Points::empty(shape);
        all.append(&points);
        all.append(&points);
        assert_eq!((points.count(), all.count(), points.widths()), (3, 6, [6, 3, 3]));
        assert_eq!(points.row(0, 1), [2.0, 3.0, 4.0, 5.0, 6.0, 7.0]);
        for at in 0..3 {
            assert_eq!(points.row(1, at), [[0.0, 1.0, 2.0], [1.0, 2.0, 3.0], [50.0, 51.0, 52.0]][at]);
            assert_eq!((all.row(0, at), all.row(2, at + 3)), (points.row(0, at), points.row(2, at)));
        }
        assert_eq!(all.values(2).len(), 2 * (4 + 2 + 3));
        let none = Points::new(rows(0, 2), shape).unwrap();
        assert_eq!((none.count(), Points::new(rows(0, 0), shape).unwrap().count()), (0, 0));
        assert_eq!(Points::new(rows(0, 4), PointShape { length: 0, ..shape }).unwrap_err().field, "shape");
    }

    #[test]
    fn points_of_the_wrong_shape_or_out_of_range_are_rejected() {
        let new = |values: [Vec<f32>; PARTS], widths| Points::new(values, widths).map(|points| points.count());
        assert_eq!(new([vec![1.0; 4], vec![1.0; 2], vec![1.0; 6]], [2, 1, 3]), Ok(2));
        assert_eq!(new([vec![], vec![], vec![]], [1; 3]), Ok(0));
        for (values, widths, field) in [
            ([vec![1.0; 4], vec![1.0; 2], vec![]], [2, 1, 0], "shape"),
            ([vec![1.0; 4], vec![1.0; 3], vec![1.0; 6]], [2, 1, 3], "values"),
            ([vec![1.0; 3], vec![1.0], vec![1.0; 3]], [2, 1, 3], "values"),
            ([vec![f32::NAN], vec![1.0], vec![1.0]], [1; 3], "values"),
            ([vec![1.0], vec![f32::INFINITY], vec![1.0]], [1; 3], "values"),
            ([vec![1.0], vec![1.0], vec![-2e15]], [1; 3], "values"),
        ] {
            assert_eq!(new(values, widths).unwrap_err().field, field);
        }
    }
}
