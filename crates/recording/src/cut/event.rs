//! What a message of an event topic marks.

use crate::dialect::{Value, json};
use crate::limits::MOST_JSON_DEPTH;

/// Words of a text that mark an episode, by what they state of it.
const SUCCESS: &[&str] = &["success", "successful", "successfully", "succeed", "succeeds", "succeeded"];
const FAILURE: &[&str] = &["fail", "fails", "failed", "failure", "unsuccessful", "unsuccessfully"];
const END: &[&str] = &[
    "end",
    "ends",
    "ended",
    "stop",
    "stops",
    "stopped",
    "done",
    "finish",
    "finishes",
    "finished",
    "complete",
    "completes",
    "completed",
];
const DISCARD: &[&str] = &[
    "discard",
    "discards",
    "discarded",
    "abort",
    "aborts",
    "aborted",
    "cancel",
    "cancels",
    "canceled",
    "cancelled",
    "reset",
];
const BEGIN: &[&str] = &["begin", "begins", "began", "start", "starts", "started"];
/// Words that deny one of the next two words, as in `not a success`.
const NOT: &[&str] = &["no", "not", "never", "without", "isnt", "wasnt", "didnt"];
/// Values of the word before them, as in `success: no`.
const YES: &[&str] = &["true", "yes"];
const NO: &[&str] = &["false", "no", "not"];
const UNKNOWN: &[&str] = &["null", "none", "unknown"];
/// Fields whose texts come first, if a message has several.
const EVENT_FIELDS: &[&str] = &["data", "event", "status", "state"];
/// Most words of a text that are read.
const MOST_WORDS: usize = 1000;

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
        Self::stated(message).unwrap_or_else(|| flag(message).map_or(Self::Begin, Self::Number))
    }

    /// What the texts of a message state, and its flag `success`; `None` if it has neither. The first text with a known
    /// word counts.
    fn stated(message: &Value<'_>) -> Option<Self> {
        let success = SUCCESS.iter().find_map(|name| message.number(name)).map(|flag| flag != 0.0);
        let texts = texts(message);
        match (texts.iter().find_map(|text| Self::in_text(text)), success) {
            (Some(Self::End(None)), Some(_)) => Some(Self::End(success)),
            (Some(event), _) => Some(event),
            // Another text than one of these, such as the name of a person, states nothing of the episode.
            (None, Some(_)) if EVENT_FIELDS.iter().all(|name| message.text(name).is_none()) => Some(Self::End(success)),
            (None, _) => (!texts.is_empty()).then_some(Self::Begin),
        }
    }

    /// What a text states: one that is a JSON object as the message that it is, another one by its words. `None` without
    /// a known word.
    fn in_text(text: &str) -> Option<Self> {
        if text.trim_start().starts_with('{')
            && let Ok(message) = json::decode(text.as_bytes(), MOST_JSON_DEPTH)
        {
            return Self::stated(&message);
        }
        let lower = text.to_lowercase().replace(['\'', '’'], "");
        let words = lower.split(|c: char| !c.is_alphanumeric()).filter(|word| !word.is_empty());
        let words: Vec<&str> = words.take(MOST_WORDS).collect();
        let has = |list: &[&str], wanted| {
            words.iter().enumerate().any(|(at, word)| list.contains(word) && holds(&words, at) == Some(wanted))
        };
        Some(match () {
            () if has(DISCARD, true) => Self::Discard,
            () if has(FAILURE, true) || has(SUCCESS, false) => Self::End(Some(false)),
            () if has(SUCCESS, true) => Self::End(Some(true)),
            () if has(END, true) => Self::End(None),
            () if has(BEGIN, true) => Self::Begin,
            () => return None,
        })
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

/// Whether the word at this place holds or is denied by a word beside it; `None` if its value is unknown.
fn holds(words: &[&str], at: usize) -> Option<bool> {
    let word = |at: Option<usize>| at.and_then(|at| words.get(at)).copied().unwrap_or_default();
    let digits = |word: &str| !word.is_empty() && word.bytes().all(|byte| byte.is_ascii_digit());
    let (value, before, earlier) = (word(Some(at + 1)), word(at.checked_sub(1)), word(at.checked_sub(2)));
    // 0 and 0.0, but not 0.8. Beside the other words it is the number of an episode.
    let outcome = [SUCCESS, FAILURE].iter().any(|list| list.contains(&word(Some(at))));
    let mut number = words.iter().skip(at + 1).take_while(|word| digits(word));
    let zero = outcome && digits(value) && number.all(|word| word.bytes().all(|byte| byte == b'0'));
    match value {
        _ if YES.contains(&value) => Some(true),
        _ if UNKNOWN.contains(&value) => None,
        _ if zero || NO.contains(&value) || NOT.contains(&before) => Some(false),
        // `no 3` is the number of an episode.
        _ => Some(!NOT.contains(&earlier) || digits(before)),
    }
}

/// The texts of a message, but for those of its header, in the order in which they count.
fn texts<'a>(message: &'a Value<'_>) -> Vec<&'a str> {
    match message {
        Value::Text(text) => vec![text],
        Value::Message(fields) => {
            let rank = |name: &str| EVENT_FIELDS.iter().position(|known| *known == name).unwrap_or(EVENT_FIELDS.len());
            let texts = fields.iter().filter(|(name, _)| name != "header" && name != "timestamp");
            let texts = texts.filter_map(|(name, value)| match value {
                Value::Text(text) => Some((rank(name), text.as_ref())).filter(|(_, text)| !text.is_empty()),
                Value::Number(_) | Value::Numbers(_) | Value::Bytes(_) | Value::List(_) | Value::Message(_) => None,
            });
            let mut texts: Vec<(usize, &str)> = texts.collect();
            texts.sort_by_key(|(rank, _)| *rank);
            texts.into_iter().map(|(_, text)| text).collect()
        }
        Value::Number(_) | Value::Numbers(_) | Value::Bytes(_) | Value::List(_) => Vec::new(),
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

    const FAILED: Event = Event::End(Some(false));
    const SUCCEEDED: Event = Event::End(Some(true));
    const ENDED: Event = Event::End(None);

    /// The event of a `std_msgs/String`.
    fn text(text: &'static str) -> Event {
        Event::of(&Value::Message(vec![("data".into(), Value::Text(text.into()))]))
    }

    /// The event of a JSON message.
    fn message(text: &str) -> Event {
        Event::of(&json::decode(text.as_bytes(), 64).unwrap())
    }

    #[test]
    fn texts_and_flags_are_events() {
        assert_eq!(text("start episode 3"), Event::Begin);
        assert_eq!(text("Episode: SUCCESS"), SUCCEEDED);
        assert_eq!(text("failed"), FAILED);
        assert_eq!(text("stop"), ENDED);
        assert_eq!(text("discard"), Event::Discard);
        assert_eq!(text("friend"), Event::Begin);
        let flag = |number| Event::of(&Value::Message(vec![("data".into(), Value::Number(number))]));
        assert_eq!((flag(1.0).resolved(false), flag(0.0).resolved(false)), (Event::Begin, ENDED));
        assert!(flag(2.0).counts() && !flag(1.0).counts());
        assert_eq!(flag(0.0).resolved(true), Event::Begin);
        assert_eq!(Event::of(&Value::Message(Vec::new())), Event::Begin);
    }

    #[test]
    fn every_form_of_a_word_is_known() {
        for ended in ["episode ended", "stopped", "completed", "finished", "Done."] {
            assert_eq!(text(ended), ENDED, "{ended}");
        }
        for discarded in ["aborted", "cancelled", "canceled", "discarded by anna"] {
            assert_eq!(text(discarded), Event::Discard, "{discarded}");
        }
        for failed in ["unsuccessful", "attempt fails"] {
            assert_eq!(text(failed), FAILED, "{failed}");
        }
        assert_eq!(text("grasp successful"), SUCCEEDED);
    }

    #[test]
    fn a_denied_success_is_a_failure() {
        for failed in [
            "success: false",
            "success=0",
            "success: 0.0",
            "Success? No",
            "no success",
            "not a success",
            "didn't succeed",
            "end, success: False",
            "{'aborted': False, 'success': False}",
        ] {
            assert_eq!(text(failed), FAILED, "{failed}");
        }
        for succeeded in [
            "success: true",
            "success 0.8",
            "success=1 failure=0",
            "episode 0: success",
            "no 3: success",
            "{'failed': False, 'success': True}",
            "aborted: false, success",
        ] {
            assert_eq!(text(succeeded), SUCCEEDED, "{succeeded}");
        }
        assert_eq!((text("end, success: null"), text("not yet done")), (ENDED, Event::Begin));
        assert_eq!(text("end 0"), ENDED);
    }

    #[test]
    fn a_flag_of_success_states_the_outcome_of_an_end() {
        for (json, event) in [
            (r#"{"event":"end","success":false}"#, FAILED),
            (r#"{"event":"end","success":true}"#, SUCCEEDED),
            (r#"{"event":"end","success":null}"#, ENDED),
            (r#"{"event":"start","success":false}"#, Event::Begin),
            (r#"{"event":"attempt 3","success":false}"#, Event::Begin),
            (r#"{"by":"anna","success":false}"#, FAILED),
            (r#"{"success":true}"#, SUCCEEDED),
        ] {
            assert_eq!(message(json), event, "{json}");
            // The same JSON as the text of a `std_msgs/String`.
            let quoted = serde_json::json!({ "data": json }).to_string();
            assert_eq!(message(&quoted), event, "{quoted}");
        }
    }

    #[test]
    fn the_text_that_states_an_event_counts_among_several() {
        for (json, event) in [
            (r#"{"event":"success","by":"anna"}"#, SUCCEEDED),
            (r#"{"event":"start","comment":"the last one failed"}"#, Event::Begin),
            (r#"{"a_note":"gripper stopped","status":"failed"}"#, FAILED),
            (r#"{"by":"anna","result":"failed"}"#, FAILED),
            (r#"{"by":"anna","event":"attempt"}"#, Event::Begin),
            (r#""success""#, SUCCEEDED),
        ] {
            assert_eq!(message(json), event, "{json}");
        }
    }
}
