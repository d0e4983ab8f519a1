//! What a caller shows: the bearer token of a request's headers, and its hash.

use tonic::codegen::http::{HeaderMap, header::AUTHORIZATION};

use crate::error::{Error, Result};

/// How a token is kept and found. A fast hash is right: a token is 256 random bits, so there is nothing to guess that
/// a slow hash would have to make dear; and because it is looked up by its hash, how long that takes tells nothing of
/// any token.
pub(crate) fn hash(token: &str) -> String {
    blake3::hash(token.as_bytes()).to_hex().to_string()
}

/// Marks what a request shows, so that no log of headers has it.
pub(super) fn hide(headers: &mut HeaderMap) {
    if let Some(value) = headers.get_mut(AUTHORIZATION) {
        value.set_sensitive(true);
    }
}

/// The token that a request shows, if it shows one.
///
/// # Errors
/// Unauthenticated when what it shows is no bearer token.
pub(super) fn bearer(headers: &HeaderMap) -> Result<Option<&str>> {
    let Some(value) = headers.get(AUTHORIZATION) else { return Ok(None) };
    let token = value.to_str().ok().and_then(|text| text.split_once(' ')).and_then(|(scheme, token)| {
        let token = token.trim();
        (scheme.eq_ignore_ascii_case("bearer") && !token.is_empty()).then_some(token)
    });
    match token {
        Some(token) => Ok(Some(token)),
        None => Err(Error::unauthenticated("the authorization header must be `Bearer` and a token")),
    }
}

/// The hash of the token that a request shows, if it shows one.
///
/// # Errors
/// As [`bearer`].
pub(super) fn shown(headers: &HeaderMap) -> Result<Option<String>> {
    Ok(bearer(headers)?.map(hash))
}

#[cfg(test)]
mod tests {
    use tonic::codegen::http::HeaderValue;

    use super::*;

    fn headers(value: &'static [u8]) -> HeaderMap {
        HeaderMap::from_iter([(AUTHORIZATION, HeaderValue::from_bytes(value).unwrap())])
    }

    #[test]
    fn a_bearer_token_is_read_and_hidden() {
        for value in [b"Bearer secret123".as_slice(), b"bearer  secret123"] {
            let mut headers = headers(value);
            assert_eq!(shown(&headers).unwrap(), Some(hash("secret123")));
            hide(&mut headers);
            assert!(!format!("{headers:?}").contains("secret123"));
        }
        assert_eq!(shown(&HeaderMap::new()).unwrap(), None);
    }

    #[test]
    fn what_is_no_bearer_token_is_refused_without_repeating_it() {
        for value in [b"Basic secret123".as_slice(), b"secret123", b"Bearer", b"Bearer ", b"Bearer secret123\xff", b""]
        {
            let problem = shown(&headers(value)).unwrap_err().to_string();
            assert!(!problem.contains("secret123"), "{problem}");
        }
    }
}
