//! Fields of a task from the names that a dataset has for its numbers.
//!
//! A dataset has one vector with a name for each value; a task has named fields. Values named `joints.0`, `joints.1` and so
//! on are one field, as an export of this crate writes them; other values are a field each. Must not know a format.

use std::collections::BTreeSet;

use gleaner_core::{FieldSpec, ValueRange};

use super::description::FieldOrigin;

/// The error of a variance in a dataset's statistics, as a part of the squared span.
const ROUNDING: f64 = 1e-4;
/// With more fields than this, or without names of their own, the values of a feature are one field.
const MOST_FIELDS: usize = 64;

/// The numbers of one feature.
pub(super) struct Vector {
    /// The dataset's name of the feature.
    pub(super) feature: String,
    /// The name of its field if it is one.
    pub(super) name: String,
    pub(super) size: u32,
    /// A name for each value, or none.
    pub(super) names: Vec<String>,
    /// What is stated of each value, or none.
    pub(super) stated: Vec<Stated>,
}

/// What a dataset states of one number over all of its steps.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Stated {
    pub(super) range: ValueRange,
    /// Its values in rising order, if there are at most two.
    pub(super) values: Option<Vec<f64>>,
}

impl Stated {
    /// What is stated by a range alone.
    pub(super) fn range(range: ValueRange) -> Self {
        Self { range, values: None }
    }

    /// What is stated by a range, mean and standard deviation. The variance is (maximum − mean) · (mean − minimum) if every
    /// value is one of the two bounds, and smaller otherwise.
    pub(super) fn moments(range: ValueRange, mean: f64, deviation: f64) -> Self {
        let ValueRange { minimum, maximum } = range;
        let between = (maximum - mean) * (mean - minimum) - deviation * deviation;
        let bounds = if minimum < maximum { vec![minimum, maximum] } else { vec![minimum] };
        let only = between.abs() <= ROUNDING * (maximum - minimum).powi(2);
        Self { range, values: only.then_some(bounds) }
    }

    /// What is stated of both.
    pub(super) fn with(self, other: Self) -> Self {
        let mut values = self.values.zip(other.values).map(|(own, more)| [own, more].concat());
        if let Some(all) = &mut values {
            all.sort_by(f64::total_cmp);
            all.dedup();
        }
        Self { range: self.range.with(other.range), values: values.filter(|all| all.len() <= 2) }
    }
}

/// The fields of proprioception and action, with their origins: the features in their order, each whole.
pub(super) fn fields(state: &[Vector], action: &[Vector]) -> (Vec<FieldSpec>, Vec<FieldSpec>, Vec<FieldOrigin>) {
    let [mut state_groups, mut action_groups] = [state, action].map(grouped);
    let names = |groups: &[Group]| groups.iter().map(|group| group.name.clone()).collect::<BTreeSet<_>>();
    if !names(&state_groups).is_disjoint(&names(&action_groups)) {
        // Joints and their targets often have the same names.
        action_groups.iter_mut().for_each(|group| group.name.insert_str(0, "action_"));
    }
    if !names(&state_groups).is_disjoint(&names(&action_groups)) {
        state_groups.iter_mut().for_each(|group| group.name.insert_str(0, "state_"));
    }
    let specs = |groups: &[Group]| groups.iter().map(|group| FieldSpec::new(&group.name, group.size)).collect();
    let specs: (Vec<FieldSpec>, Vec<FieldSpec>) = (specs(&state_groups), specs(&action_groups));
    let origins = state_groups.into_iter().chain(action_groups).map(|group| group.origin).collect();
    (specs.0, specs.1, origins)
}

struct Group {
    name: String,
    size: u32,
    origin: FieldOrigin,
}

/// The groups of several features; if their names are not their own, each feature is one group.
fn grouped(vectors: &[Vector]) -> Vec<Group> {
    let groups: Vec<Group> = vectors.iter().flat_map(split).collect();
    let names: BTreeSet<&str> = groups.iter().map(|group| group.name.as_str()).collect();
    if names.len() == groups.len() && groups.len() <= MOST_FIELDS {
        return groups;
    }
    let mut taken = BTreeSet::new();
    let whole = |vector: &Vector| {
        let own = identifier(&vector.name);
        let numbered = (2..).map(|number| format!("{own}_{number}"));
        let name = std::iter::once(own.clone()).chain(numbered).find(|name| taken.insert(name.clone()));
        group(vector, name.unwrap_or(own), 0..vector.size as usize)
    };
    vectors.iter().map(whole).collect()
}

fn split(vector: &Vector) -> Vec<Group> {
    if vector.names.len() != vector.size as usize {
        return vec![group(vector, identifier(&vector.name), 0..vector.size as usize)];
    }
    let mut groups: Vec<Group> = Vec::new();
    let mut begin = 0;
    while begin < vector.names.len() {
        let member = |at: usize| vector.names[begin + at].rsplit_once('.').filter(|(_, last)| *last == at.to_string());
        let run = match member(0) {
            Some((base, _)) => {
                let same = |at: &usize| member(*at).is_some_and(|(other, _)| other == base);
                (0..vector.names.len() - begin).take_while(same).count()
            }
            None => 1,
        };
        let name = match member(0) {
            Some((base, _)) if run > 1 => base,
            Some(_) | None => &vector.names[begin],
        };
        groups.push(group(vector, identifier(name), begin..begin + run));
        begin += run;
    }
    groups
}

fn group(vector: &Vector, name: String, part: std::ops::Range<usize>) -> Group {
    let stated = vector.stated.get(part.clone()).and_then(|stated| stated.iter().cloned().reduce(Stated::with));
    let origin = FieldOrigin {
        feature: vector.feature.clone(),
        names: vector.names.get(part.clone()).unwrap_or_default().to_vec(),
        range: stated.as_ref().map(|stated| stated.range),
        values: stated.and_then(|stated| stated.values).unwrap_or_default(),
    };
    Group { name, size: u32::try_from(part.len()).unwrap_or(u32::MAX), origin }
}

/// The name as one of a task's field: a letter, then letters, digits and `_`.
pub(super) fn identifier(name: &str) -> String {
    let plain = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
    let mut name: String = name.chars().take(100).map(plain).collect();
    // `timestamp` is the stamp of a message.
    if !name.starts_with(|c: char| c.is_ascii_alphabetic()) || name == "timestamp" {
        name.insert_str(0, "value_");
    }
    name
}

#[cfg(test)]
mod tests {
    use super::*;

    fn vector(feature: &str, names: &[&str]) -> Vector {
        Vector {
            feature: feature.into(),
            name: feature.rsplit('.').next().unwrap().into(),
            size: u32::try_from(names.len()).unwrap(),
            names: names.iter().map(|name| (*name).to_owned()).collect(),
            stated: Vec::new(),
        }
    }

    #[test]
    fn two_values_are_seen_from_their_moments() {
        let moments = |values: &[f64]| {
            let count = f64::from(u32::try_from(values.len()).unwrap());
            let mean = values.iter().sum::<f64>() / count;
            let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / count;
            let range = values.iter().map(|&value| ValueRange::of(value)).reduce(ValueRange::with).unwrap();
            Stated::moments(range, mean, variance.sqrt())
        };
        assert_eq!(moments(&[0.0, 1.0, 1.0, 0.0, 1.0]).values, Some(vec![0.0, 1.0]));
        assert_eq!(moments(&[0.0, 1.0, 1.0, 0.5, 1.0]).values, None);
        assert_eq!(moments(&[0.1, 0.1]).values, Some(vec![0.1]));
        // An episode whose gripper stays open, beside others.
        let open = moments(&[0.0, 0.0]);
        assert_eq!(open.clone().with(moments(&[0.0, 1.0])).values, Some(vec![0.0, 1.0]));
        assert_eq!(open.clone().with(moments(&[0.5, 1.0])).values, None);
        assert_eq!(open.with(Stated::range(ValueRange::of(0.0))).values, None);
    }

    fn named(fields: &[FieldSpec]) -> Vec<(&str, u32)> {
        fields.iter().map(|field| (field.name.as_str(), field.size)).collect()
    }

    #[test]
    fn numbered_values_are_one_field_and_others_one_each() {
        let state = [vector("observation.state", &["joints.0", "joints.1", "gripper", "x.0"])];
        let action = [vector("action", &["command.0", "command.1"])];
        let (state, action, origins) = fields(&state, &action);
        assert_eq!(named(&state), [("joints", 2), ("gripper", 1), ("x_0", 1)]);
        assert_eq!(named(&action), [("command", 2)]);
        assert_eq!(origins[0].names, ["joints.0", "joints.1"]);
        assert_eq!(origins[3].feature, "action");
    }

    #[test]
    fn names_that_are_not_their_own_give_way() {
        let joints = ["pan.pos", "lift.pos"];
        let (state, action, _) = fields(&[vector("observation.state", &joints)], &[vector("action", &joints)]);
        assert_eq!(named(&state), [("pan_pos", 1), ("lift_pos", 1)]);
        assert_eq!(named(&action), [("action_pan_pos", 1), ("action_lift_pos", 1)]);
        let (state, _, _) = fields(&[vector("observation.state", &["a", "a"])], &[vector("action", &["b"])]);
        assert_eq!(named(&state), [("state", 2)]);
        let nameless = Vector { names: Vec::new(), ..vector("action", &["a", "b", "c"]) };
        let (_, action, _) = fields(&[vector("observation.state", &["0", "timestamp"])], &[nameless]);
        assert_eq!(named(&action), [("action", 3)]);
        let (state, _, _) = fields(&[vector("observation.state", &["0", "timestamp"])], &[vector("action", &["b"])]);
        assert_eq!(named(&state), [("value_0", 1), ("value_timestamp", 1)]);
    }
}
