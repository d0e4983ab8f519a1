//! The values that a task's actions may take. A policy predicts any number; the robot executes one that is allowed.
//!
//! Plain data: must not know policies or sessions. Each action that is sent to a robot or a simulator, and each that is
//! remembered as executed, has passed [`ActionRanges::apply`].

use serde::{Deserialize, Serialize};

use crate::bound::Bound;
use crate::task_spec::FieldSpec;

/// The values that one number of an action may take.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ActionRange {
    /// Any value.
    #[default]
    Free,
    /// From the first to the second, both included.
    Within(f32, f32),
    /// At least the first.
    AtLeast(f32),
    /// At most the first.
    AtMost(f32),
    /// One of the two, such as a gripper's "close" and "open".
    Binary(f32, f32),
}

/// The ranges of an action's values, in their order. An empty list leaves every value free.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct ActionRanges(Vec<ActionRange>);

impl ActionRange {
    /// The range between two bounds, either of which may be missing; `binary` if it has no value between them.
    #[must_use]
    pub fn new(minimum: Option<f32>, maximum: Option<f32>, binary: bool) -> Self {
        match (minimum, maximum) {
            (Some(low), Some(high)) if binary => Self::Binary(low, high),
            (Some(minimum), Some(maximum)) => Self::Within(minimum, maximum),
            (Some(minimum), None) => Self::AtLeast(minimum),
            (None, Some(maximum)) => Self::AtMost(maximum),
            (None, None) => Self::Free,
        }
    }

    /// The ranges of a field's values, in their order.
    pub fn of_values(field: &FieldSpec) -> impl Iterator<Item = Self> {
        let of = |bound: &Option<Bound>, index| bound.as_ref().and_then(|bound| bound.of(index));
        let FieldSpec { minimum, maximum, binary, .. } = field;
        (0..field.size as usize).map(move |index| Self::new(of(minimum, index), of(maximum, index), *binary))
    }

    /// Its bounds, and whether it is binary: the inverse of [`ActionRange::new`].
    #[must_use]
    pub fn bounds(self) -> (Option<f32>, Option<f32>, bool) {
        match self {
            Self::Free => (None, None, false),
            Self::Within(minimum, maximum) => (Some(minimum), Some(maximum), false),
            Self::AtLeast(minimum) => (Some(minimum), None, false),
            Self::AtMost(maximum) => (None, Some(maximum), false),
            Self::Binary(low, high) => (Some(low), Some(high), true),
        }
    }

    /// The allowed value nearest to `value`; of a binary pair the upper one where both are equally near. A number that is
    /// not finite stays as it is: it shows a policy that has failed, which a bound in its place would hide.
    #[must_use]
    pub fn nearest(self, value: f32) -> f32 {
        if !value.is_finite() {
            return value;
        }
        match self {
            Self::Free => value,
            Self::Within(minimum, maximum) => value.max(minimum).min(maximum),
            Self::AtLeast(minimum) => value.max(minimum),
            Self::AtMost(maximum) => value.min(maximum),
            Self::Binary(low, high) if value < f32::midpoint(low, high) => low,
            Self::Binary(_, high) => high,
        }
    }
}

impl ActionRanges {
    /// The ranges of an action with these fields.
    #[must_use]
    pub fn of(fields: &[FieldSpec]) -> Self {
        fields.iter().flat_map(ActionRange::of_values).collect()
    }

    /// The range of each value; none if every value is free.
    #[must_use]
    pub fn each(&self) -> &[ActionRange] {
        &self.0
    }

    /// Whether value number `index` is one of a pair. Such values are never averaged.
    #[must_use]
    pub fn is_binary(&self, index: usize) -> bool {
        matches!(self.0.get(index), Some(ActionRange::Binary(..)))
    }

    /// Replaces each value by the nearest allowed one.
    pub fn apply(&self, action: &mut [f32]) {
        for (value, range) in action.iter_mut().zip(&self.0) {
            *value = range.nearest(*value);
        }
    }
}

impl FromIterator<ActionRange> for ActionRanges {
    fn from_iter<I: IntoIterator<Item = ActionRange>>(ranges: I) -> Self {
        let all: Vec<ActionRange> = ranges.into_iter().collect();
        if all.iter().all(|range| *range == ActionRange::Free) { Self::default() } else { Self(all) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_value_becomes_the_nearest_allowed_one() {
        let fields = [
            FieldSpec { minimum: Some(Bound::All(-1.0)), maximum: Some(Bound::All(1.0)), ..FieldSpec::new("move", 2) },
            FieldSpec {
                minimum: Some(Bound::All(-1.0)),
                maximum: Some(Bound::All(1.0)),
                binary: true,
                ..FieldSpec::new("gripper", 1)
            },
            FieldSpec { minimum: Some(Bound::All(0.0)), ..FieldSpec::new("force", 1) },
            FieldSpec { maximum: Some(Bound::All(5.0)), ..FieldSpec::new("speed", 1) },
            FieldSpec::new("free", 1),
        ];
        let ranges = ActionRanges::of(&fields);
        let mut action = [-3.0, 0.5, 0.4, -0.1, 6.0, 99.0];
        ranges.apply(&mut action);
        assert_eq!(action, [-1.0, 0.5, 1.0, 0.0, 5.0, 99.0]);
        let mut action = [2.0, -0.5, -0.1, 7.0, 4.0, -99.0];
        ranges.apply(&mut action);
        assert_eq!(action, [1.0, -0.5, -1.0, 7.0, 4.0, -99.0]);
        for range in ranges.each() {
            let (minimum, maximum, binary) = range.bounds();
            assert_eq!(ActionRange::new(minimum, maximum, binary), *range);
        }
        assert!(ranges.is_binary(2) && !ranges.is_binary(1) && !ranges.is_binary(6));
    }

    #[test]
    fn values_have_bounds_of_their_own() {
        let (minimum, maximum) = (Some(Bound::Each(vec![-0.5, 0.0])), Some(Bound::Each(vec![0.5, 3.0])));
        let joints = FieldSpec { minimum, maximum, ..FieldSpec::new("joints", 2) };
        let lift = FieldSpec { minimum: Some(Bound::Each(vec![1.0, 2.0])), ..FieldSpec::new("lift", 2) };
        let ranges = ActionRanges::of(&[joints, lift]);
        let mut action = [-1.0, -1.0, 0.0, 0.0];
        ranges.apply(&mut action);
        assert_eq!(action, [-0.5, 0.0, 1.0, 2.0]);
        let mut action = [9.0, 9.0, 9.0, 9.0];
        ranges.apply(&mut action);
        assert_eq!(action, [0.5, 3.0, 9.0, 9.0]);
    }

    #[test]
    fn a_number_that_is_not_finite_does_not_become_a_bound() {
        let ranges = [
            ActionRange::Free,
            ActionRange::Within(-1.0, 1.0),
            ActionRange::AtLeast(0.0),
            ActionRange::AtMost(5.0),
            ActionRange::Binary(-1.0, 1.0),
        ];
        for range in ranges {
            assert!(range.nearest(f32::NAN).is_nan(), "{range:?}");
            for infinite in [f32::INFINITY, f32::NEG_INFINITY] {
                assert_eq!(range.nearest(infinite).to_bits(), infinite.to_bits(), "{range:?}");
            }
        }
    }

    #[test]
    fn fields_without_ranges_leave_every_value_free() {
        let ranges = ActionRanges::of(&[FieldSpec::new("move", 3)]);
        assert!(ranges.each().is_empty());
        let mut action = [-7.0, 0.0, 1e9];
        ranges.apply(&mut action);
        assert_eq!(action, [-7.0, 0.0, 1e9]);
    }
}
