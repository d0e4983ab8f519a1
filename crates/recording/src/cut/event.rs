//! What a message of an event topic marks.

use crate::dialect::Value;

/// Words of a text that end an episode, by what they state of it.
const SUCCESS: &[&str] = &["success", "succeeded"];
const FAILURE: &[&str] = &["fail", "failure", "failed"];
const END: &[&str] = &["end", "stop", "done", "finish", "finished"];
const DISCARD: &[&str] = &["discard", "abort", "cancel", "reset"];

/// What a message marks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Event {
    /// An episode begins here; one that runs ends.
    Begin,
    /// The episode ends, with its outcome if that is stated.
    End(Option<bool>),
    /// The running episode is left out.
    Discard,
    /// A flag, or the number of an episode: which of both, the other messages of the topic show.
    Number(f64),
}

impl Event {
    /// A text ends an episode by its words; every other text begins one. A number is an event of its own.
    pub(super) fn of(message: &Value<'_>) -> Self {
        if let Some(text) = text(message) {
            let lower = text.to_ascii_lowercase();
            let words = lower.split(|c: char| !c.is_ascii_alphanumeric());
            let has = |list: &[&str]| words.clone().any(|word| list.contains(&word));
            return match () {
                () if has(DISCARD) => Self::Discard,
                () if has(FAILURE) => Self::End(Some(false)),
                () if has(SUCCESS) => Self::End(Some(true)),
                () if has(END) => Self::End(None),
                () => Self::Begin,
            };
        }
        flag(message).map_or(Self::Begin, Self::Number)
    }

    /// What a number marks: `counted` states whether the topic numbers its episodes, so that 0 begins one too.
    pub(super) fn resolved(self, counted: bool) -> Self {
        match self {
            Self::Number(number) if number == 0.0 && !counted => Self::End(None),
            Self::Number(_) => Self::Begin,
            Self::Begin | Self::End(_) | Self::Discard => self,
        }
    }

    /// Whether it is a number that no flag has.
    pub(super) fn counts(self) -> bool {
        matches!(self, Self::Number(number) if number > 1.0)
    }
}

/// The first text of a message, but for those of its header.
fn text<'a>(message: &'a Value<'_>) -> Option<&'a str> {
    match message {
        Value::Text(text) => Some(text),
        Value::Message(fields) => {
            fields.iter().filter(|(name, _)| name != "header" && name != "timestamp").find_map(|(_, value)| {
                if let Value::Text(text) = value { Some(text.as_ref()).filter(|text| !text.is_empty()) } else { None }
            })
        }
        Value::Number(_) | Value::Numbers(_) | Value::Bytes(_) | Value::List(_) => None,
    }
}

/// The flag of a message that has `data`, as ROS's standard messages do, or nothing else.
fn flag(message: &Value<'_>) -> Option<f64> {
    match message {
        Value::Number(number) => Some(*number),
        Value::Message(fields) => match fields.as_slice() {
            [(_, Value::Number(number))] => Some(*number),
            _ => message.number("data"),
        },
        Value::Numbers(_) | Value::Bytes(_) | Value::Text(_) | Value::List(_) => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_and_flags_are_events() {
        let text = |text: &'static str| Event::of(&Value::Message(vec![("data".into(), Value::Text(text.into()))]));
        assert_eq!(text("start episode 3"), Event::Begin);
        assert_eq!(text("Episode: SUCCESS"), Event::End(Some(true)));
        assert_eq!(text("failed"), Event::End(Some(false)));
        assert_eq!(text("stop"), Event::End(None));
        assert_eq!(text("discard"), Event::Discard);
        assert_eq!(text("friend"), Event::Begin);
        let flag = |number| Event::of(&Value::Message(vec![("data".into(), Value::Number(number))]));
        assert_eq!((flag(1.0).resolved(false), flag(0.0).resolved(false)), (Event::Begin, Event::End(None)));
        assert!(flag(2.0).counts() && !flag(1.0).counts());
        assert_eq!(flag(0.0).resolved(true), Event::Begin);
        assert_eq!(Event::of(&Value::Message(Vec::new())), Event::Begin);
    }
}
