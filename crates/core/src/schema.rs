//! The schema of a setting: its name, documentation, allowed values and default; and the check of a map of settings.

use serde::{Deserialize, Serialize};
use serde_json::{Map, Number, Value};

/// Settings by name, as JSON values.
pub type Values = Map<String, Value>;

/// Largest integer that the wire carries: every integer up to it has an exact double.
pub const LARGEST: u64 = (1 << 53) - 1;
/// Characters of a rejected value that an error quotes.
const SHOWN: usize = 80;

/// A setting with a wrong value: its name, what is wrong, and what would be right.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{field}: {message}")]
pub struct Problem {
    /// The setting, such as `learning_rate`.
    pub field: String,
    /// The fault, and the allowed values.
    pub message: String,
}

impl Problem {
    /// A problem of one setting.
    pub fn new(field: impl Into<String>, message: impl Into<String>) -> Self {
        Self { field: field.into(), message: message.into() }
    }
}

/// One setting of a kind of job, a policy, a weighting, an objective or a scorer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Setting {
    /// Its name, in snake case; unique among all settings of one kind of job.
    pub name: String,
    /// Its effect, unit and trade-off.
    pub about: String,
    /// Its allowed values.
    pub shape: Shape,
    /// Its value when it is left out.
    pub default: Value,
}

/// Allowed values of a setting.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "type", rename_all = "snake_case")]
pub enum Shape {
    /// A whole number.
    Integer {
        /// The smallest allowed.
        least: u64,
        /// The largest allowed.
        most: u64,
    },
    /// A number.
    Number {
        /// The smallest allowed.
        least: f64,
        /// The largest allowed.
        most: f64,
    },
    /// True or false.
    Flag,
    /// One of several words.
    Word {
        /// The words.
        words: Vec<WordAbout>,
    },
    /// A list of words, each at most once, at least one.
    Words {
        /// The words.
        words: Vec<WordAbout>,
    },
    /// One number for each name, not all of them zero.
    Numbers {
        /// The meaning of each number.
        names: Vec<String>,
        /// The smallest allowed.
        least: f64,
        /// The largest allowed.
        most: f64,
    },
    /// A list of whole numbers, each at most once, at least one.
    Integers {
        /// The largest allowed.
        most: u64,
        /// Most numbers in the list.
        count: usize,
    },
    /// A text.
    Text,
}

/// A word that is an allowed value of a setting.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct WordAbout {
    /// The word.
    pub word: String,
    /// Its meaning.
    pub about: String,
}

impl Setting {
    /// The value in its own form (`3.0` for a whole number becomes `3`).
    ///
    /// # Errors
    /// The value is of another type, or outside the allowed range.
    pub fn check(&self, value: &Value) -> Result<Value, Problem> {
        self.shape.check(value).map_err(|message| Problem::new(&self.name, message))
    }
}

impl Shape {
    fn check(&self, value: &Value) -> Result<Value, String> {
        match self {
            Self::Integer { least, most } => integer(value, *least, *most),
            Self::Number { least, most } => number(value, *least, *most),
            Self::Flag => value.as_bool().map(Value::Bool).ok_or_else(|| expected(value, "true or false")),
            Self::Word { words } => word(value, words),
            Self::Words { words } => several(value, |one| word(one, words), words.len(), &names(words)),
            Self::Numbers { names, least, most } => {
                let given = value.as_array().filter(|given| given.len() == names.len());
                let given =
                    given.ok_or_else(|| expected(value, &format!("{} numbers: {}", names.len(), names.join(", "))))?;
                let checked = given
                    .iter()
                    .zip(names)
                    .map(|(one, name)| number(one, *least, *most).map_err(|message| format!("{name} {message}")));
                let checked = checked.collect::<Result<Vec<_>, _>>()?;
                if checked.iter().all(|one| one.as_f64() == Some(0.0)) {
                    return Err(format!("is 0 for {}; at least one must be above 0", names.join(", ")));
                }
                Ok(Value::Array(checked))
            }
            Self::Integers { most, count } => several(value, |one| integer(one, 0, *most), *count, "whole numbers"),
            Self::Text => value.as_str().map(Value::from).ok_or_else(|| expected(value, "a text")),
        }
    }

    /// The smallest and largest number that is allowed, and whether it is whole; `None` for other shapes.
    #[must_use]
    pub fn range(&self) -> Option<(f64, f64, bool)> {
        match self {
            #[expect(clippy::cast_precision_loss, reason = "an integer of the wire has an exact double")]
            Self::Integer { least, most } => Some((*least as f64, (*most).min(LARGEST) as f64, true)),
            Self::Number { least, most } => Some((*least, *most, false)),
            Self::Flag
            | Self::Word { .. }
            | Self::Words { .. }
            | Self::Numbers { .. }
            | Self::Integers { .. }
            | Self::Text => None,
        }
    }

    /// The words that may be chosen; empty for other shapes.
    #[must_use]
    pub fn words(&self) -> &[WordAbout] {
        match self {
            Self::Word { words } | Self::Words { words } => words,
            Self::Integer { .. }
            | Self::Number { .. }
            | Self::Flag
            | Self::Numbers { .. }
            | Self::Integers { .. }
            | Self::Text => &[],
        }
    }
}

/// A whole number of at least `least` and at most `most`.
#[must_use]
pub fn integer_in(least: u64, most: u64) -> Shape {
    Shape::Integer { least, most }
}

/// A number of at least `least` and at most `most`.
#[must_use]
pub fn number_in(least: f64, most: f64) -> Shape {
    Shape::Number { least, most }
}

fn integer(value: &Value, least: u64, most: u64) -> Result<Value, String> {
    let whole = value.as_u64().or_else(|| value.as_f64().and_then(whole));
    let limit = most.min(LARGEST);
    let whole = whole.ok_or_else(|| expected(value, &format!("a whole number between {least} and {limit}")))?;
    if (least..=most).contains(&whole) {
        return Ok(whole.into());
    }
    Err(format!("is {whole}, must be between {least} and {most}"))
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "checked to be whole and in range")]
#[expect(clippy::cast_precision_loss, reason = "LARGEST has an exact double")]
pub(crate) fn whole(value: f64) -> Option<u64> {
    (value.fract() == 0.0 && (0.0..=LARGEST as f64).contains(&value)).then_some(value as u64)
}

fn number(value: &Value, least: f64, most: f64) -> Result<Value, String> {
    let real = value.as_f64().ok_or_else(|| expected(value, &format!("a number between {least} and {most}")))?;
    if !(least..=most).contains(&real) {
        return Err(format!("is {real}, must be between {least} and {most}"));
    }
    Number::from_f64(real).map(Value::Number).ok_or_else(|| expected(value, "a finite number"))
}

fn word(value: &Value, words: &[WordAbout]) -> Result<Value, String> {
    let text = value.as_str().ok_or_else(|| expected(value, &names(words)))?;
    if words.iter().any(|known| known.word == text) {
        return Ok(text.into());
    }
    Err(format!("unknown value {}; supported: {}", brief(value), names(words)))
}

fn names(words: &[WordAbout]) -> String {
    words.iter().map(|known| known.word.as_str()).collect::<Vec<_>>().join(", ")
}

fn several(
    value: &Value,
    one: impl Fn(&Value) -> Result<Value, String>,
    most: usize,
    of: &str,
) -> Result<Value, String> {
    let given = value.as_array().ok_or_else(|| expected(value, &format!("a list of {of}")))?;
    // First, because each value is compared with those before it: a caller's list may have millions.
    if given.is_empty() || given.len() > most {
        return Err(format!("has {} values, must have between 1 and {most}", given.len()));
    }
    let mut checked = Vec::with_capacity(given.len());
    for (place, each) in given.iter().enumerate() {
        let each = one(each).map_err(|message| format!("[{place}] {message}"))?;
        if checked.contains(&each) {
            return Err(format!("[{place}] is {} again; name each value once", brief(&each)));
        }
        checked.push(each);
    }
    Ok(Value::Array(checked))
}

fn expected(value: &Value, what: &str) -> String {
    format!("expected {what}, got {}", brief(value))
}

/// The start of a value for an error's text, since a caller's value may have any length.
pub(crate) fn brief(value: &Value) -> String {
    shortened(&value.to_string())
}

fn shortened(text: &str) -> String {
    match text.char_indices().nth(SHOWN) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text.to_owned(),
    }
}

/// The settings of `schema`, complete: each value checked, defaults filled in. `others` names settings that exist
/// elsewhere, and their owners, for the error text alone.
///
/// # Errors
/// An unknown setting, or a value that its setting does not allow.
pub fn complete(
    schema: &[Setting],
    values: &Values,
    others: impl Fn(&str) -> Option<String>,
) -> Result<Values, Problem> {
    if let Some(unknown) = values.keys().find(|name| schema.iter().all(|setting| setting.name != **name)) {
        let message = others(unknown).unwrap_or_else(|| {
            let known: Vec<&str> = schema.iter().map(|setting| setting.name.as_str()).collect();
            format!("unknown setting; supported: {}", known.join(", "))
        });
        return Err(Problem::new(shortened(unknown), message));
    }
    let value = |setting: &Setting| match values.get(&setting.name) {
        None | Some(Value::Null) => Ok((setting.name.clone(), setting.default.clone())),
        Some(given) => Ok((setting.name.clone(), setting.check(given)?)),
    };
    schema.iter().map(value).collect()
}

#[cfg(test)]
mod tests;
