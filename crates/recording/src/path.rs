//! Field paths (`a.b`, `a.b[2]`, `a.b[0:9]`), which select numbers of a message.
//!
//! Works on [`Value`] alone, so it is the same for every dialect. A field after a list applies to each of
//! the list's elements: `joints.position` is every joint's position.

use std::collections::HashMap;

use crate::dialect::Value;

/// Longest path in bytes.
const MOST_BYTES: usize = 1024;
/// Most names that an error repeats.
const NAMES_SHOWN: usize = 32;

/// A parsed field path.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Path {
    segments: Vec<Segment>,
}

#[derive(Clone, Debug, PartialEq, Eq)]
enum Segment {
    Field(String),
    Index(usize),
    /// From the first up to, not including, the second.
    Range(usize, usize),
}

/// The reason why a path gives no numbers.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Missing {
    /// The message's `name` array lacks some of the wanted names; another message may carry them.
    Names(String),
    /// The path leads nowhere in this kind of message.
    Path(String),
}

impl Path {
    /// Parses a path; the error has the reason and the form of paths.
    pub(crate) fn parse(text: &str) -> Result<Self, String> {
        let explain = |what: &str| format!("`{text}`: {what}; paths look like `a.b`, `a.b[2]` or `a.b[0:9]`");
        if text.len() > MOST_BYTES {
            return Err(format!("has {} bytes, at most {MOST_BYTES} are read", text.len()));
        }
        let mut segments = Vec::new();
        for part in text.split('.') {
            let (name, brackets) = part.find('[').map_or((part, ""), |at| part.split_at(at));
            if name.is_empty() || !name.chars().all(|c| c.is_alphanumeric() || "_-/".contains(c)) {
                return Err(explain("a field name is missing or has an unsupported character"));
            }
            segments.push(Segment::Field(name.to_owned()));
            let mut rest = brackets;
            while !rest.is_empty() {
                let inner = rest.strip_prefix('[').and_then(|rest| rest.split_once(']'));
                let (inner, after) = inner.ok_or_else(|| explain("a bracket is not closed"))?;
                segments
                    .push(Segment::subscript(inner).ok_or_else(|| explain("a subscript is not a number or range"))?);
                rest = after;
            }
        }
        Ok(Self { segments })
    }

    /// Appends the numbers that the path leads to.
    pub(crate) fn numbers(&self, message: &Value<'_>, out: &mut Vec<f64>) -> Result<(), Missing> {
        walk(&self.segments, message, &mut |value| value.append_numbers(out)).map_err(Missing::Path)
    }

    /// Appends, for each wanted name, the number that stands at its place in the message's `name` array.
    pub(crate) fn numbers_by_name(
        &self,
        message: &Value<'_>,
        wanted: &[String],
        out: &mut Vec<f64>,
    ) -> Result<(), Missing> {
        let mut sibling = self.segments.clone();
        // A subscript after the last field applies to the values, not to the names.
        while matches!(sibling.last(), Some(Segment::Index(_) | Segment::Range(..))) {
            sibling.pop();
        }
        sibling.pop();
        sibling.push(Segment::Field("name".to_owned()));
        let mut names: Vec<String> = Vec::new();
        walk(&sibling, message, &mut |value| value.append_texts(&mut names)).map_err(Missing::Path)?;
        let mut values = Vec::new();
        self.numbers(message, &mut values)?;
        if values.len() != names.len() {
            return Err(Missing::Path(format!("there are {} values for {} names", values.len(), names.len())));
        }
        // The first of two equal names counts.
        let by_name: HashMap<&str, f64> = names.iter().map(String::as_str).zip(values).rev().collect();
        let begin = out.len();
        for name in wanted {
            if let Some(&value) = by_name.get(name.as_str()) {
                out.push(value);
            } else {
                out.truncate(begin);
                return Err(Missing::Names(format!("no `{name}` among the names {}", first_names(&names))));
            }
        }
        Ok(())
    }
}

impl Segment {
    fn subscript(text: &str) -> Option<Self> {
        match text.split_once(':') {
            None => text.parse().ok().map(Self::Index),
            Some((from, to)) => {
                let (from, to) = (from.parse().ok()?, to.parse().ok()?);
                (from < to).then_some(Self::Range(from, to))
            }
        }
    }
}

/// Some of the names, for an error.
fn first_names(names: &[String]) -> String {
    let more = if names.len() > NAMES_SHOWN { ", …" } else { "" };
    names.iter().take(NAMES_SHOWN).map(String::as_str).collect::<Vec<_>>().join(", ") + more
}

/// Follows the segments and calls `found` with each value at their end, which may reject it.
fn walk(
    segments: &[Segment],
    value: &Value<'_>,
    found: &mut dyn FnMut(&Value<'_>) -> Result<(), String>,
) -> Result<(), String> {
    let Some((segment, rest)) = segments.split_first() else {
        return found(value);
    };
    match (segment, value) {
        (Segment::Field(name), Value::Message(fields)) => match fields.iter().find(|(field, _)| field == name) {
            Some((_, inner)) => walk(rest, inner, found),
            None => Err(format!("there is no `{name}`; the message has {}", value.field_names())),
        },
        (Segment::Field(_), Value::List(items)) => items.iter().try_for_each(|item| walk(segments, item, found)),
        (Segment::Field(name), _) => Err(format!("`{name}` is not a field of {}", value.kind())),
        (Segment::Index(at), _) => elements(value, *at, at.saturating_add(1), rest, found),
        (Segment::Range(from, to), _) => elements(value, *from, *to, rest, found),
    }
}

fn elements(
    value: &Value<'_>,
    from: usize,
    to: usize,
    rest: &[Segment],
    found: &mut dyn FnMut(&Value<'_>) -> Result<(), String>,
) -> Result<(), String> {
    let outside = |length: usize| format!("element {} is outside of an array of {length}", to.saturating_sub(1));
    match value {
        Value::Numbers(numbers) => {
            let part = numbers.get(from..to).ok_or_else(|| outside(numbers.len()))?;
            part.iter().try_for_each(|&number| walk(rest, &Value::Number(number), found))
        }
        Value::Bytes(bytes) => {
            let part = bytes.get(from..to).ok_or_else(|| outside(bytes.len()))?;
            part.iter().try_for_each(|&byte| walk(rest, &Value::Number(f64::from(byte)), found))
        }
        Value::List(items) => {
            let part = items.get(from..to).ok_or_else(|| outside(items.len()))?;
            part.iter().try_for_each(|item| walk(rest, item, found))
        }
        Value::Number(_) | Value::Text(_) | Value::Message(_) => {
            Err(format!("an element cannot be selected from {}", value.kind()))
        }
    }
}

#[cfg(test)]
mod tests;
