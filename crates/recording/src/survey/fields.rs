//! The fields of a topic's messages: kinds, sizes, ranges and names.
//!
//! A field is a path as mappings have it. This module does not depend on images.

use std::collections::HashMap;

use crate::dialect::Value;
use gleaner_core::{FieldKind, SurveyedField, ValueRange};

/// Most fields of a topic.
const MAX_FIELDS: usize = 512;
/// Most values of a field whose ranges are kept.
const MAX_VALUES: usize = 1024;
/// Most characters of a text.
const MAX_TEXT: usize = 64;
/// Most names of a field.
const MAX_NAMES: usize = 256;

/// Fields and values that the topics of a recording may still have.
pub(super) struct Budget(usize);

impl Default for Budget {
    fn default() -> Self {
        Self(1 << 16)
    }
}

impl Budget {
    /// Whether this many were left; they are used up then.
    fn take(&mut self, count: usize) -> bool {
        let left = self.0.checked_sub(count);
        self.0 = left.unwrap_or(self.0);
        left.is_some()
    }
}

/// What is known of a topic's fields so far.
#[derive(Default)]
pub(super) struct FieldNotes {
    fields: Vec<SurveyedField>,
    places: HashMap<String, usize>,
    more: bool,
}

/// One field of one message.
enum Leaf {
    Number(f64),
    Numbers(Vec<f64>),
    Texts(Vec<String>),
    Bytes(usize),
    Other(usize),
}

impl FieldNotes {
    /// Adds a message.
    pub(super) fn push(&mut self, message: &Value<'_>, budget: &mut Budget) {
        let mut leaves = Vec::new();
        flatten(message, "", &mut leaves);
        let names: HashMap<&str, &[String]> = leaves
            .iter()
            .filter_map(|(path, leaf)| match leaf {
                Leaf::Texts(texts) => Some((parent_of_names(path)?, texts.as_slice())),
                Leaf::Number(_) | Leaf::Numbers(_) | Leaf::Bytes(_) | Leaf::Other(_) => None,
            })
            .collect();
        for (path, leaf) in &leaves {
            let parent = path.rsplit_once('.').map_or("", |(parent, _)| parent);
            let names = match leaf {
                Leaf::Numbers(numbers) => names.get(parent).copied().filter(|names| names.len() == numbers.len()),
                Leaf::Number(_) | Leaf::Texts(_) | Leaf::Bytes(_) | Leaf::Other(_) => None,
            };
            match self.place(path, budget) {
                Some(field) => self.more |= !note(field, leaf, names.unwrap_or_default(), budget),
                None => self.more = true,
            }
        }
    }

    /// The fields, and whether there are more.
    pub(super) fn finish(mut self) -> (Vec<SurveyedField>, bool) {
        for field in &mut self.fields {
            if !field.is_fixed() {
                field.ranges.clear();
            }
            if field.values.len() > 2 {
                field.values.clear();
            }
        }
        (self.fields, self.more)
    }

    fn place(&mut self, path: &str, budget: &mut Budget) -> Option<&mut SurveyedField> {
        let at = match self.places.get(path) {
            Some(&at) => at,
            None if self.fields.len() < MAX_FIELDS && budget.take(1) => {
                self.places.insert(path.to_owned(), self.fields.len());
                self.fields.push(SurveyedField { path: path.to_owned(), ..SurveyedField::default() });
                self.fields.len() - 1
            }
            None => return None,
        };
        self.fields.get_mut(at)
    }
}

/// The parent of an array of names; `None` for another path.
fn parent_of_names(path: &str) -> Option<&str> {
    match path.rsplit_once('.') {
        Some((parent, "name")) => Some(parent),
        None if path == "name" => Some(""),
        Some(_) | None => None,
    }
}

/// Adds the values of a message to a field; false if some were left out.
fn note(field: &mut SurveyedField, leaf: &Leaf, names: &[String], budget: &mut Budget) -> bool {
    let (kind, length) = match leaf {
        Leaf::Number(_) => (FieldKind::Number, 1),
        Leaf::Numbers(numbers) => (FieldKind::Numbers, numbers.len()),
        Leaf::Texts(texts) => (FieldKind::Text, texts.iter().map(String::len).sum()),
        Leaf::Bytes(length) => (FieldKind::Bytes, *length),
        Leaf::Other(length) => (FieldKind::Other, *length),
    };
    let length = length as u64;
    (field.shortest, field.longest) = match field.messages {
        0 => (length, length),
        _ => (field.shortest.min(length), field.longest.max(length)),
    };
    // An empty array may be one of anything.
    if field.messages == 0 || field.longest == 0 || field.kind == FieldKind::Number {
        field.kind = kind;
    }
    field.messages += 1;
    match leaf {
        Leaf::Number(number) => numbers(field, &[*number], &[], budget),
        Leaf::Numbers(values) => numbers(field, values, names, budget),
        Leaf::Texts(texts) => {
            if let (true, Some(first)) = (field.text.is_empty(), texts.first()) {
                field.text = first.chars().take(MAX_TEXT).collect();
            }
            true
        }
        Leaf::Bytes(_) | Leaf::Other(_) => true,
    }
}

fn numbers(field: &mut SurveyedField, values: &[f64], names: &[String], budget: &mut Budget) -> bool {
    let mut whole = true;
    for (at, &value) in values.iter().enumerate() {
        let place = match names.get(at) {
            Some(name) => match field.names.iter().position(|known| known == name) {
                Some(place) => place,
                None if field.names.len() < MAX_NAMES && field.ranges.len() == field.names.len() => {
                    field.names.push(name.chars().take(MAX_TEXT).collect());
                    field.names.len() - 1
                }
                None => {
                    whole = false;
                    continue;
                }
            },
            None => at,
        };
        if !value.is_finite() {
            field.not_finite += 1;
        }
        if field.values.len() <= 2 && !field.values.contains(&value) {
            field.values.push(value);
        }
        let (value, next) = (ValueRange::of(value), field.ranges.len());
        match field.ranges.get_mut(place) {
            // The smaller of a number and NaN is the number.
            Some(range) => *range = range.with(value),
            None if place < MAX_VALUES && place == next && budget.take(1) => field.ranges.push(value),
            None => whole = false,
        }
    }
    whole
}

/// The fields of a message, each once; the elements of a list of messages are concatenated, as a path reads them.
fn flatten(value: &Value<'_>, path: &str, leaves: &mut Vec<(String, Leaf)>) {
    match value {
        Value::Message(fields) => {
            for (name, inner) in fields {
                let path = if path.is_empty() { name.to_string() } else { format!("{path}.{name}") };
                flatten(inner, &path, leaves);
            }
        }
        Value::List(items) if items.iter().any(|item| matches!(item, Value::Message(_))) => {
            for item in items {
                let mut inner = Vec::new();
                flatten(item, path, &mut inner);
                inner.into_iter().for_each(|(path, leaf)| append(leaves, path, leaf));
            }
        }
        Value::List(items) if items.iter().any(|item| matches!(item, Value::Text(_))) => {
            let texts = items.iter().filter_map(|item| match item {
                Value::Text(text) => Some(text.clone().into_owned()),
                Value::Number(_) | Value::Numbers(_) | Value::Bytes(_) | Value::List(_) | Value::Message(_) => None,
            });
            leaves.push((path.to_owned(), Leaf::Texts(texts.collect())));
        }
        Value::List(items) if items.is_empty() => leaves.push((path.to_owned(), Leaf::Numbers(Vec::new()))),
        Value::List(items) => leaves.push((path.to_owned(), Leaf::Other(items.len()))),
        Value::Number(number) => leaves.push((path.to_owned(), Leaf::Number(*number))),
        Value::Numbers(numbers) => leaves.push((path.to_owned(), Leaf::Numbers(numbers.clone()))),
        Value::Text(text) => leaves.push((path.to_owned(), Leaf::Texts(vec![text.clone().into_owned()]))),
        Value::Bytes(bytes) => leaves.push((path.to_owned(), Leaf::Bytes(bytes.len()))),
    }
}

/// Adds a part of a field that a list of messages holds.
fn append(leaves: &mut Vec<(String, Leaf)>, path: String, leaf: Leaf) {
    let as_list = |leaf: Leaf| match leaf {
        Leaf::Number(number) => Leaf::Numbers(vec![number]),
        other @ (Leaf::Numbers(_) | Leaf::Texts(_) | Leaf::Bytes(_) | Leaf::Other(_)) => other,
    };
    let leaf = as_list(leaf);
    match (leaves.iter_mut().find(|(known, _)| *known == path), leaf) {
        (Some((_, Leaf::Numbers(numbers))), Leaf::Numbers(more)) => numbers.extend(more),
        (Some((_, Leaf::Texts(texts))), Leaf::Texts(more)) => texts.extend(more),
        // Parts of different kinds are not concatenated.
        (Some(_), _) => {}
        (None, leaf) => leaves.push((path, leaf)),
    }
}
