//! Episodes by the messages of an event topic.

use super::Span;
use super::event::Event;
use super::look::Look;
use crate::error::RecordingError;

/// The episodes that the messages of a topic mark, in order.
///
/// # Errors
/// [`RecordingError::Field`] if the topic has no message, or none begins an episode.
pub(super) fn spans(topic: &str, look: &Look) -> Result<Vec<Span>, RecordingError> {
    let wrong = |problem: String| RecordingError::Field { topic: topic.to_owned(), path: "-".to_owned(), problem };
    if look.events.is_empty() {
        let known: Vec<&str> = look.topics.iter().map(String::as_str).take(32).collect();
        return Err(wrong(format!("the recording has no message of it; its topics are {}", known.join(", "))));
    }
    let mut events = look.events.clone();
    events.sort_by_key(|(time, _)| *time);
    let counted = events.iter().any(|(_, event)| event.counts());
    let mut spans: Vec<Span> = Vec::new();
    let mut open: Option<u64> = None;
    for (time, event) in events {
        let (ended, event) = (open.take(), event.resolved(counted));
        match event {
            Event::Discard => {}
            Event::Begin | Event::End(_) | Event::Number(_) => {
                spans.extend(ended.filter(|begin| *begin < time).map(|begin| Span {
                    begin,
                    end: time,
                    success: if let Event::End(success) = event { success } else { None },
                }))
            }
        }
        open = (event == Event::Begin).then_some(time);
    }
    spans.extend(open.map(|begin| Span { begin, end: u64::MAX, success: None }));
    if spans.is_empty() {
        return Err(wrong("its messages mark no episode: none begins one".to_owned()));
    }
    Ok(spans)
}
