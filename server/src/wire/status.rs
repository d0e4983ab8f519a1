//! The one table from our errors to gRPC status codes. Logs each error once, where it leaves the house.

use tonic::{Code, Status};

use crate::error::{Error, Kind};

/// What the caller of an rpc sees of an error. Internal ones say a fixed sentence and an id to find the log line by.
pub(crate) fn from_error(error: Error) -> Status {
    let code = match error.kind() {
        Kind::Invalid => Code::InvalidArgument,
        Kind::NotFound => Code::NotFound,
        Kind::Exists => Code::AlreadyExists,
        Kind::Precondition => Code::FailedPrecondition,
        Kind::Exhausted => Code::ResourceExhausted,
        Kind::Cancelled => Code::Cancelled,
        Kind::Late => Code::DeadlineExceeded,
        Kind::Unavailable => Code::Unavailable,
        Kind::Internal => {
            let request_id = ulid::Ulid::generate().to_string();
            tracing::error!(request.id = %request_id, %error, "request failed");
            return Status::internal(format!(
                "something went wrong in the server; its log tells more under request {request_id}"
            ));
        }
    };
    tracing::debug!(%error, ?code, "request refused");
    Status::new(code, error.message())
}

/// A worker's call without a valid token of a running attempt.
pub(crate) fn not_this_job() -> Status {
    Status::unauthenticated("this call needs the token of a running attempt of a job")
}

/// What a stream's sender did wrong, when the transport tells instead of a message: it went away, or sent one that
/// is too large or no message at all.
pub(crate) fn from_peer(status: Status) -> Error {
    let message = status.message();
    if matches!(status.code(), Code::OutOfRange | Code::ResourceExhausted) {
        Error::exhausted(format!("{message}; send smaller messages"))
    } else if matches!(status.code(), Code::Internal | Code::InvalidArgument) {
        Error::invalid("message", format!("cannot be read: {message}"))
    } else {
        Error::cancelled(format!("the caller has gone: {message}"))
    }
}
