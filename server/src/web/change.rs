//! Changes: who sends a form is led on to a page, a program that sends JSON is told in JSON; the audit log hears what it
//! was about, also when it was refused.

use axum::{
    Json,
    http::{
        HeaderMap, StatusCode,
        header::{CONTENT_TYPE, LOCATION},
    },
    response::{IntoResponse as _, Response},
};
use serde_json::Value;

use super::{door::Subjects, refusal::Answer};

/// Whether a program has sent this.
pub(super) fn is_json(headers: &HeaderMap) -> bool {
    headers.get(CONTENT_TYPE).is_some_and(|kind| kind.as_bytes().starts_with(b"application/json"))
}

/// The answer to a change that was made: on to `page`, or what is to be `told`.
pub(super) fn done(json: bool, page: &str, told: Value) -> Response {
    if json {
        return Json(told).into_response();
    }
    (StatusCode::SEE_OTHER, [(LOCATION, page)]).into_response()
}

/// An answer with what it was about, `field=value`.
pub(super) fn about(field: &str, value: &str, answer: Answer) -> Response {
    let mut response = answer.into_response();
    let subject = format!("{field}={}", value.chars().take(64).collect::<String>());
    response.extensions_mut().insert(Subjects(vec![subject]));
    response
}
