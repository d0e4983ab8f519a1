//! Reading single fields of a request: a missing, empty or out-of-range value is rejected with the field's name and a
//! remedy.

use prost_types::Timestamp;

pub use crate::tag::tag;
use crate::{
    error::{Error, Result},
    time::Millis,
};

/// A message field that must be set.
pub fn required<T>(field: &str, value: Option<T>) -> Result<T> {
    value.ok_or_else(|| Error::invalid(field, "must be set"))
}

/// A text of 1 to 255 bytes without control characters.
pub fn text(field: &str, value: String) -> Result<String> {
    if value.is_empty() {
        return Err(Error::invalid(field, "must not be empty"));
    }
    tag(field, value)
}

/// A page size: 0 means 100, more than 1000 is refused.
pub fn page_size(value: u32) -> Result<u32> {
    match value {
        0 => Ok(100),
        1..=1000 => Ok(value),
        _ => Err(Error::invalid("page_size", "must be at most 1000")),
    }
}

/// The refusal of a page token that this server did not return.
pub fn foreign_page_token() -> Error {
    Error::invalid(
        "page_token",
        "is not a page token: leave it empty, or send the next_page_token of the previous response",
    )
}

/// A point in time for the wire.
pub fn timestamp(time: Millis) -> Timestamp {
    let nanos = i32::try_from(time.0.rem_euclid(1000) * 1_000_000).unwrap_or(0);
    Timestamp { seconds: time.0.div_euclid(1000), nanos }
}
