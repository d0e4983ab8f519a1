//! Pages of lists on the wire: a size, and a token that has the key of the last row of the page before. A token of another
//! call has another form and is rejected.

use super::field;
use crate::{error::Result, page::Page};

/// Reads a page. `key` reads the key of a row from a token.
///
/// # Errors
/// Invalid when the page is too large, or the token has no key.
pub fn page<K>(size: u32, token: &str, key: impl FnOnce(&str) -> Option<K>) -> Result<Page<K>> {
    let after = match token {
        "" => None,
        token => Some(key(token).ok_or_else(field::foreign_page_token)?),
    };
    Ok(Page { after, size: field::page_size(size)? })
}

/// Reads a page of rows whose keys are ids. A token is an id.
///
/// # Errors
/// As for [`page`].
pub fn page_by_id<K: TryFrom<String>>(size: u32, token: &str) -> Result<Page<K>> {
    page(size, token, |token| token.to_owned().try_into().ok())
}

/// The token of the page that follows a row; empty behind the last page.
pub fn token(next: Option<impl Into<String>>) -> String {
    next.map(Into::into).unwrap_or_default()
}

/// A token that has what its call lists before the key of a row.
pub fn named_token(what: &str, key: impl std::fmt::Display) -> String {
    format!("{what}:{key}")
}

/// The key of a token of [`named_token`]; `None` for one of another call.
pub fn named_key<'a>(what: &str, token: &'a str) -> Option<&'a str> {
    token.strip_prefix(what)?.strip_prefix(':')
}
