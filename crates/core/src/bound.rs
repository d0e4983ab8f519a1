//! The bounds of a field's values: one number for all of them, or one for each.
//!
//! Plain data. This module does not depend on the task of the field.

use std::fmt;

use serde::{Deserialize, Serialize};

/// A bound of the values of an action field.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged, expecting = "expected a number, or a list with a number for each value")]
pub enum Bound {
    /// The bound of every value.
    All(f32),
    /// The bound of each value, in their order.
    Each(Vec<f32>),
}

impl Bound {
    /// The bound of value number `index`; `None` beyond the list.
    #[must_use]
    pub fn of(&self, index: usize) -> Option<f32> {
        match self {
            Self::All(bound) => Some(*bound),
            Self::Each(bounds) => bounds.get(index).copied(),
        }
    }

    /// The number of values that it bounds, if that is stated.
    #[must_use]
    pub fn count(&self) -> Option<usize> {
        match self {
            Self::All(_) => None,
            Self::Each(bounds) => Some(bounds.len()),
        }
    }
}

impl fmt::Display for Bound {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::All(bound) => write!(f, "{bound}"),
            Self::Each(bounds) => {
                let bounds: Vec<String> = bounds.iter().map(f32::to_string).collect();
                write!(f, "[{}]", bounds.join(", "))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bound_is_a_number_or_a_list_in_a_file() {
        let read = |text: &str| serde_json::from_str::<Bound>(text);
        assert_eq!(read("-1").unwrap(), Bound::All(-1.0));
        assert_eq!(read("[-0.25, 1]").unwrap(), Bound::Each(vec![-0.25, 1.0]));
        for bound in [Bound::All(0.1), Bound::Each(vec![0.1, -2.0])] {
            assert_eq!(read(&serde_json::to_string(&bound).unwrap()).unwrap(), bound);
        }
        for text in ["\"low\"", "[1, \"low\"]", "{}", "null"] {
            assert!(read(text).unwrap_err().to_string().starts_with("expected a number, or a list"), "{text}");
        }
    }

    #[test]
    fn each_value_has_its_own_bound_or_that_of_all() {
        let (all, each) = (Bound::All(0.5), Bound::Each(vec![1.0, -2.0]));
        assert_eq!((all.of(0), all.of(7), all.count()), (Some(0.5), Some(0.5), None));
        assert_eq!((each.of(1), each.of(2), each.count()), (Some(-2.0), None, Some(2)));
        assert_eq!((all.to_string(), each.to_string()), ("0.5".to_owned(), "[1, -2]".to_owned()));
    }
}
