//! An error as a page: its status, and one sentence with the fix.

use axum::{
    http::StatusCode,
    response::{IntoResponse, Response},
};
use gleaner_core::{Error, error::Kind};
use ulid::Ulid;

/// The result of every page.
pub(super) type Answer = Result<Response, Refusal>;

/// An error on its way to a browser. The middleware makes a page or JSON of it.
#[derive(Debug)]
pub(super) struct Refusal(pub(super) Error);

impl From<Error> for Refusal {
    fn from(error: Error) -> Self {
        Self(error)
    }
}

/// The text of an error, until the middleware has written it.
#[derive(Debug, Clone)]
pub(super) struct ErrorText(pub(super) String);

impl IntoResponse for Refusal {
    fn into_response(self) -> Response {
        let status = status(self.0.kind());
        let message = if self.0.kind() == Kind::Internal {
            let request_id = Ulid::generate();
            tracing::error!(request.id = %request_id, error = %self.0, "a page failed");
            format!("The server failed; see its log for request {request_id}.")
        } else {
            if self.0.kind() == Kind::Damaged {
                tracing::error!(error = %self.0, "a stored file cannot be used");
            }
            tracing::debug!(error = %self.0, %status, "a page was refused");
            self.0.message().to_owned()
        };
        let mut response = status.into_response();
        response.extensions_mut().insert(ErrorText(message));
        response
    }
}

/// The one table from our errors to HTTP.
pub(super) fn status(kind: Kind) -> StatusCode {
    match kind {
        Kind::Invalid => StatusCode::BAD_REQUEST,
        Kind::Unauthenticated => StatusCode::UNAUTHORIZED,
        Kind::Forbidden => StatusCode::FORBIDDEN,
        Kind::NotFound => StatusCode::NOT_FOUND,
        Kind::Exists | Kind::Precondition => StatusCode::CONFLICT,
        Kind::Exhausted => StatusCode::TOO_MANY_REQUESTS,
        Kind::Cancelled | Kind::Unavailable => StatusCode::SERVICE_UNAVAILABLE,
        Kind::Late => StatusCode::GATEWAY_TIMEOUT,
        Kind::Damaged | Kind::Internal => StatusCode::INTERNAL_SERVER_ERROR,
    }
}
