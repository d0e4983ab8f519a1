//! Changes: each is made and audited in one frame. A form is redirected to a page, a JSON request gets JSON.

use axum::{
    Json,
    http::{
        HeaderMap, StatusCode,
        header::{CONTENT_TYPE, LOCATION},
    },
    response::{IntoResponse as _, Response},
};
use serde_json::Value;

use super::{page_request::PageRequest, refusal::Answer};

/// Makes a change of these subjects, fields and values as sent. Its audit entry, also of a refused change, is on disk
/// before the response is sent. `making` adds subjects that only it has.
pub(super) async fn change<'a>(
    request: &PageRequest,
    subjects: impl IntoIterator<Item = (&'a str, &'a str)>,
    making: impl Future<Output = Answer>,
) -> Response {
    subjects.into_iter().for_each(|(field, value)| request.audit.about(field, value));
    let response = making.await.into_response();
    request.audit.write(request.backend(), response.status()).await;
    response
}

/// Whether the request comes from a program.
pub(super) fn is_json(headers: &HeaderMap) -> bool {
    headers.get(CONTENT_TYPE).is_some_and(|kind| kind.as_bytes().starts_with(b"application/json"))
}

/// Whether the request comes from a form.
pub(super) fn is_form(headers: &HeaderMap) -> bool {
    headers.get(CONTENT_TYPE).is_some_and(|kind| kind.as_bytes().starts_with(b"application/x-www-form"))
}

/// The response to a change: a redirect to `page`, or the JSON.
pub(super) fn done(json: bool, page: &str, answer: Value) -> Response {
    if json {
        return Json(answer).into_response();
    }
    (StatusCode::SEE_OTHER, [(LOCATION, page)]).into_response()
}
