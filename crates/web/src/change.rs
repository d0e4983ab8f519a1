//! Responses to changes: a form is redirected to a page, a JSON request gets JSON. The audit log records the subjects,
//! of refused changes too.

use axum::{
    Json,
    http::{
        HeaderMap, StatusCode,
        header::{CONTENT_TYPE, LOCATION},
    },
    response::{IntoResponse as _, Response},
};
use serde_json::Value;

use super::{middleware::Subjects, refusal::Answer};

/// The most characters of a value in the audit log.
const LONGEST: usize = 160;

/// Whether the request comes from a program.
pub(super) fn is_json(headers: &HeaderMap) -> bool {
    headers.get(CONTENT_TYPE).is_some_and(|kind| kind.as_bytes().starts_with(b"application/json"))
}

/// The response to a change: a redirect to `page`, or the JSON.
pub(super) fn done(json: bool, page: &str, answer: Value) -> Response {
    if json {
        return Json(answer).into_response();
    }
    (StatusCode::SEE_OTHER, [(LOCATION, page)]).into_response()
}

/// A response, or an error, with its subjects: fields and values as sent.
pub(super) fn about<'a>(subjects: impl IntoIterator<Item = (&'a str, &'a str)>, answer: Answer) -> Response {
    let mut response = answer.into_response();
    let subjects = subjects.into_iter().map(|(field, value)| subject(field, value)).collect();
    response.extensions_mut().insert(Subjects(subjects));
    response
}

/// `field=value`, escaped for display: control characters would reach a terminal.
fn subject(field: &str, value: &str) -> String {
    format!("{field}={}", value.escape_debug().take(LONGEST).collect::<String>())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn subjects_are_shortened_and_escaped() {
        let refused = Err(gleaner_core::Error::invalid("id", "must be an id").into());
        let long = "\u{1b}[2J\n".repeat(1000);
        let response = about([("job_id", long.as_str()), ("task", "reach")], refused);
        let Some(Subjects(subjects)) = response.extensions().get() else { unreachable!("it has no subjects") };
        assert_eq!(subjects[1], "task=reach");
        assert_eq!(subjects[0].len(), "job_id=".len() + LONGEST);
        assert!(subjects[0].starts_with("job_id=\\u{1b}[2J\\n") && !subjects[0].contains(char::is_control));
    }
}
