//! Conversions from columns: words, ids, counts and packed arrays to domain values.
//!
//! An unreadable row is a fault of the server, never of the caller.

use crate::error::{Error, Result};

/// Reads a column that must contain a known word or id.
pub(super) fn parsed<T>(column: &str, value: Option<T>) -> Result<T> {
    value.ok_or_else(|| Error::internal(format!("reading the column {column}"), "the value is not one of ours"))
}

/// Reads an id column.
pub(super) fn id<T: TryFrom<String, Error = String>>(column: &str, text: String) -> Result<T> {
    T::try_from(text).map_err(|problem| Error::internal(format!("reading the column {column}"), problem))
}

/// Reads a column with a count.
pub(super) fn count(column: &str, value: i64) -> Result<u64> {
    parsed(column, u64::try_from(value).ok())
}

/// Converts a count to a column's type.
pub(super) fn stored(value: u64) -> i64 {
    i64::try_from(value).unwrap_or(i64::MAX)
}

/// Reads a JSON column.
pub(super) fn json<T: serde::de::DeserializeOwned>(column: &str, text: &str) -> Result<T> {
    serde_json::from_str(text).map_err(|error| Error::internal(format!("reading the column {column}"), error))
}

/// Writes a JSON column.
pub(super) fn to_json<T: serde::Serialize>(value: &T) -> Result<String> {
    serde_json::to_string(value).map_err(|error| Error::internal("writing JSON", error))
}
