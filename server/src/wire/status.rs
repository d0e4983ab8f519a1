//! The one table from our errors to gRPC status codes. Logs each error once, where it leaves the server.

use gleaner_recording::printable::Escape;
use tonic::{Code, Status, codegen::http::HeaderMap};

use crate::{
    error::{Error, Kind},
    telemetry::request,
};

/// The longest message of an error, in bytes.
const MESSAGE_BYTES: usize = 4000;

/// The status of an error for the caller of an rpc. An internal error has a fixed message with an id, by which the log line
/// is found.
pub(crate) fn from_error(error: Error) -> Status {
    let code = match error.kind() {
        Kind::Invalid => Code::InvalidArgument,
        Kind::Unauthenticated => Code::Unauthenticated,
        Kind::Forbidden => Code::PermissionDenied,
        Kind::NotFound => Code::NotFound,
        Kind::Exists => Code::AlreadyExists,
        Kind::Precondition => Code::FailedPrecondition,
        Kind::Exhausted => Code::ResourceExhausted,
        Kind::Cancelled => Code::Cancelled,
        Kind::Late => Code::DeadlineExceeded,
        Kind::Unavailable => Code::Unavailable,
        Kind::Damaged => Code::DataLoss,
        Kind::Internal => {
            let request_id = request::id();
            tracing::error!(request.id = %request_id, %error, "request failed");
            return Status::internal(format!("the server failed; see its log for request {request_id}"));
        }
    };
    if error.kind() == Kind::Exhausted && std::error::Error::source(&error).is_some() {
        // Caused by the disk, which the operator must fix.
        tracing::error!(%error, "the disk rejects writes");
    } else if error.kind() == Kind::Damaged {
        tracing::error!(%error, "a stored file cannot be used");
    } else {
        tracing::debug!(%error, ?code, "request refused");
    }
    Status::new(code, header_text(error.message()))
}

/// The trailers that end a call with an error.
pub(crate) fn trailers(error: Error) -> HeaderMap {
    let mut trailers = HeaderMap::new();
    // Fails for messages that fit no header; `header_text` prevents that.
    let _ = from_error(error).add_header(&mut trailers);
    trailers
}

/// A message as the text of a header: shortened, because 16 KiB is a common limit of headers and non-ASCII bytes take three
/// each; escaped, because some messages repeat text of a caller or a recording and other clients print them unescaped.
fn header_text(message: &str) -> String {
    let beginning = message.get(..message.floor_char_boundary(MESSAGE_BYTES)).unwrap_or_default();
    let shown = Escape::Lines.apply(beginning);
    if beginning.len() == message.len() && shown.len() <= MESSAGE_BYTES {
        return shown.into_owned();
    }
    format!("{} … (and more)", shown.get(..shown.floor_char_boundary(MESSAGE_BYTES)).unwrap_or_default())
}

/// The status of a call to an rpc that is not in the authorisation table.
pub(crate) fn no_such_rpc() -> Status {
    Status::unimplemented("this server has no such rpc; is it older than its client?")
}

/// The error of a stream's sender, as the transport reports it in place of a message: the sender is gone, its message is too
/// large or malformed, or its token has ended.
pub(crate) fn from_peer(status: Status) -> Error {
    let message = status.message();
    if matches!(status.code(), Code::OutOfRange | Code::ResourceExhausted) {
        Error::exhausted(format!("{message}; send smaller messages"))
    } else if matches!(status.code(), Code::Internal | Code::InvalidArgument) {
        Error::invalid("message", format!("cannot be read: {message}"))
    } else if status.code() == Code::DeadlineExceeded {
        Error::late(message)
    } else if status.code() == Code::Unauthenticated {
        Error::unauthenticated(message)
    } else {
        Error::cancelled(format!("the caller disconnected: {message}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_fits_its_header_whatever_it_repeats() {
        let status = from_error(Error::not_found("task", "ü".repeat(1 << 20)));
        assert_eq!(status.code(), Code::NotFound);
        assert!(status.message().len() < 4100 && status.message().starts_with("no task üü"));
        assert_eq!(from_error(Error::not_found("task", "arm")).message(), "no task arm");
        let status = from_error(Error::not_found("task", "\u{1b}".repeat(1000)));
        assert!(status.message().len() < 4100 && status.message().starts_with("no task \\u{1b}"));
    }
}
