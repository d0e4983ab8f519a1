//! The rule of short texts: cohorts, authors, reasons, names of files.

use crate::error::{Error, Result};

/// A text that may be empty.
///
/// # Errors
/// Invalid, naming the field, when it is longer than 255 bytes or contains control characters.
pub fn tag(field: &str, value: String) -> Result<String> {
    if value.len() > 255 {
        return Err(Error::invalid(field, "must be at most 255 bytes"));
    }
    if value.chars().any(char::is_control) {
        return Err(Error::invalid(field, "must not hold control characters"));
    }
    Ok(value)
}
