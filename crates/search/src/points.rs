//! Points as plain arrays, both those of an index and queries. Must not depend on the comparison of points.

use crate::error::SearchError;

/// Parts of a point.
pub const PARTS: usize = 3;
/// Upper bound of values, below which sums of squares do not overflow.
const LIMIT: f32 = 1e15;

/// N points: per part, N rows of `width` values, row-major in single precision. Parts may differ in width.
#[derive(Debug, Clone, PartialEq)]
pub struct Points {
    values: [Vec<f32>; PARTS],
    widths: [usize; PARTS],
}

impl Points {
    /// Points with these values: per part, N rows of `widths` values each.
    ///
    /// # Errors
    /// A width is zero, the parts differ in their number of rows, or a value is not [comparable](Self::comparable).
    pub fn new(values: [Vec<f32>; PARTS], widths: [usize; PARTS]) -> Result<Self, SearchError> {
        if widths.contains(&0) {
            return Err(SearchError::new("widths", "has a zero; every part needs at least one value"));
        }
        let points = Self { values, widths };
        let count = points.count();
        if (0..PARTS).any(|i| points.values[i].len() != count * widths[i]) {
            return Err(SearchError::new("values", "do not have the same number of rows in every part"));
        }
        if !points.comparable() {
            return Err(SearchError::new("values", "must be finite and below 1e15"));
        }
        Ok(points)
    }

    /// Zero points of these widths.
    pub fn empty(widths: [usize; PARTS]) -> Self {
        Self { values: Default::default(), widths }
    }

    /// Appends rows, the same number in every part. Values are not checked; see [`Self::comparable`].
    pub fn extend<'a>(&mut self, rows: [impl AsRef<[f32]> + 'a; PARTS]) {
        for (all, rows) in self.values.iter_mut().zip(&rows) {
            all.extend_from_slice(rows.as_ref());
        }
    }

    /// Appends the rows of `other`, which has the same widths.
    pub(crate) fn append(&mut self, other: &Self) {
        self.extend(other.values.each_ref());
    }

    /// Number of points N.
    pub fn count(&self) -> usize {
        self.values[0].len() / self.widths[0].max(1)
    }

    /// Values a row, per part.
    pub fn widths(&self) -> [usize; PARTS] {
        self.widths
    }

    /// All values of `part`, row-major.
    pub fn values(&self, part: usize) -> &[f32] {
        &self.values[part]
    }

    /// The values of `part` of point `at`.
    pub fn row(&self, part: usize, at: usize) -> &[f32] {
        let width = self.widths[part];
        &self.values[part][at * width..(at + 1) * width]
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
    fn points_of_the_wrong_shape_or_out_of_range_are_rejected() {
        let new = |values: [Vec<f32>; PARTS], widths| Points::new(values, widths).map(|points| points.count());
        assert_eq!(new([vec![1.0; 4], vec![1.0; 2], vec![1.0; 6]], [2, 1, 3]), Ok(2));
        assert_eq!(new([vec![], vec![], vec![]], [1; 3]), Ok(0));
        for (values, widths, field) in [
            ([vec![1.0; 4], vec![1.0; 2], vec![]], [2, 1, 0], "widths"),
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
