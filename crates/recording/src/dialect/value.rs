//! A decoded message, independent of its dialect.

use std::borrow::Cow;

/// A decoded message or a part of it. Integers and booleans are numbers too.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Value<'a> {
    Number(f64),
    Numbers(Vec<f64>),
    Bytes(Cow<'a, [u8]>),
    Text(Cow<'a, str>),
    List(Vec<Value<'a>>),
    /// Fields in the order of the schema. Unset protobuf messages and maps are left out.
    Message(Vec<(Cow<'a, str>, Value<'a>)>),
}

impl<'a> Value<'a> {
    /// A field of a message.
    pub(crate) fn field(&self, name: &str) -> Option<&Value<'a>> {
        match self {
            Self::Message(fields) => fields.iter().find(|(field, _)| field == name).map(|(_, value)| value),
            Self::Number(_) | Self::Numbers(_) | Self::Bytes(_) | Self::Text(_) | Self::List(_) => None,
        }
    }

    /// A field that is a number.
    pub(crate) fn number(&self, name: &str) -> Option<f64> {
        match self.field(name) {
            Some(Self::Number(number)) => Some(*number),
            _ => None,
        }
    }

    /// A field that is text.
    pub(crate) fn text(&self, name: &str) -> Option<&str> {
        match self.field(name) {
            Some(Self::Text(text)) => Some(text),
            _ => None,
        }
    }

    /// A field that is bytes.
    pub(crate) fn bytes(&self, name: &str) -> Option<&[u8]> {
        match self.field(name) {
            Some(Self::Bytes(bytes)) => Some(bytes),
            _ => None,
        }
    }

    /// The header stamp in nanoseconds: foxglove's `timestamp` or ROS's `header.stamp`.
    /// A stamp of zero counts as unset, and a `timestamp` of another form, such as a device's own counter, as a field like
    /// any other.
    pub(crate) fn stamp(&self) -> Option<i64> {
        let header = || self.field("header")?.field("stamp")?.nanoseconds();
        self.field("timestamp").and_then(Self::nanoseconds).or_else(header)
    }

    /// The nanoseconds of a stamp.
    fn nanoseconds(&self) -> Option<i64> {
        let seconds = self.number("seconds").or_else(|| self.number("sec"))?;
        let nanos = ["nanos", "nanosec", "nsec"].iter().find_map(|name| self.number(name))?;
        let whole = |number: f64| {
            #[expect(clippy::cast_possible_truncation, reason = "the range is checked first")]
            (number.abs() < 4e9 && number.fract() == 0.0).then_some(number as i64)
        };
        let stamp = whole(seconds)? * 1_000_000_000 + whole(nanos)?;
        (stamp != 0).then_some(stamp)
    }

    /// Appends the numbers of a scalar or numeric array.
    pub(crate) fn append_numbers(&self, out: &mut Vec<f64>) -> Result<(), String> {
        match self {
            Self::Number(number) => out.push(*number),
            Self::Numbers(numbers) => out.extend_from_slice(numbers),
            Self::Bytes(bytes) => out.extend(bytes.iter().map(|&byte| f64::from(byte))),
            Self::List(items) if items.is_empty() => {}
            Self::Text(_) | Self::List(_) | Self::Message(_) => {
                return Err(format!("expected a number, got {}", self.kind()));
            }
        }
        Ok(())
    }

    /// Appends the texts of a text or a list of texts.
    pub(crate) fn append_texts(&self, out: &mut Vec<String>) -> Result<(), String> {
        match self {
            Self::Text(text) => out.push(text.clone().into_owned()),
            Self::List(items) => items.iter().try_for_each(|item| item.append_texts(out))?,
            Self::Numbers(numbers) if numbers.is_empty() => {}
            Self::Number(_) | Self::Numbers(_) | Self::Bytes(_) | Self::Message(_) => {
                return Err(format!("expected a name, got {}", self.kind()));
            }
        }
        Ok(())
    }

    /// A description of the kind, for an error.
    pub(crate) fn kind(&self) -> String {
        match self {
            Self::Number(_) => "a number".to_owned(),
            Self::Numbers(numbers) => format!("an array of {} numbers", numbers.len()),
            Self::Bytes(bytes) => format!("an array of {} bytes", bytes.len()),
            Self::Text(_) => "text".to_owned(),
            Self::List(items) => format!("a list of {}", items.len()),
            Self::Message(_) => format!("a message with {}", self.field_names()),
        }
    }

    /// The fields of a message, for an error.
    pub(crate) fn field_names(&self) -> String {
        match self {
            Self::Message(fields) if !fields.is_empty() => {
                fields.iter().take(32).map(|(name, _)| name.as_ref()).collect::<Vec<_>>().join(", ")
            }
            Self::Message(_) | Self::Number(_) | Self::Numbers(_) | Self::Bytes(_) | Self::Text(_) | Self::List(_) => {
                "no fields".to_owned()
            }
        }
    }
}

#[cfg(test)]
mod tests {

    use super::*;

    fn time(seconds: &'static str, nanos: &'static str, values: (f64, f64)) -> Value<'static> {
        Value::Message(vec![(seconds.into(), Value::Number(values.0)), (nanos.into(), Value::Number(values.1))])
    }

    fn message(name: &'static str, value: Value<'static>) -> Value<'static> {
        Value::Message(vec![(name.into(), value)])
    }

    #[test]
    fn finds_the_stamp_of_each_dialect() {
        assert_eq!(message("timestamp", time("seconds", "nanos", (2.0, 5.0))).stamp(), Some(2_000_000_005));
        let header = message("stamp", time("sec", "nanosec", (1.0, 7.0)));
        assert_eq!(message("header", header).stamp(), Some(1_000_000_007));
        assert_eq!(message("timestamp", time("sec", "nsec", (1.0, 7.0))).stamp(), Some(1_000_000_007));
    }

    #[test]
    fn a_header_counts_beside_a_timestamp_that_is_no_stamp() {
        let header = || message("stamp", time("sec", "nanosec", (1.0, 7.0)));
        let counter = Value::Number(123_456.0);
        let unset = time("seconds", "nanos", (0.0, 0.0));
        for own in [counter, unset] {
            let both = Value::Message(vec![("header".into(), header()), ("timestamp".into(), own)]);
            assert_eq!(both.stamp(), Some(1_000_000_007));
        }
    }

    #[test]
    fn an_unset_or_absurd_stamp_is_none() {
        assert_eq!(message("timestamp", time("seconds", "nanos", (0.0, 0.0))).stamp(), None);
        assert_eq!(message("timestamp", time("seconds", "nanos", (1e30, 0.0))).stamp(), None);
        assert_eq!(message("timestamp", Value::Number(3.0)).stamp(), None);
        assert_eq!(Value::Number(3.0).stamp(), None);
    }
}
