//! The bearer token in a request's headers, and its hash.

use tonic::codegen::http::{HeaderMap, header::AUTHORIZATION};

use crate::error::{Error, Result};

/// The hash by which a token is stored and looked up. A fast hash suffices: 256 random bits cannot be guessed, and the time
/// of a lookup by hash reveals nothing about any token.
pub(crate) fn hash(token: &str) -> String {
    blake3::hash(token.as_bytes()).to_hex().to_string()
}

/// Marks the token in the headers as sensitive, so that logs of headers omit it.
pub(super) fn hide(headers: &mut HeaderMap) {
    if let Some(value) = headers.get_mut(AUTHORIZATION) {
        value.set_sensitive(true);
    }
}

/// The token in the headers, if they have one.
///
/// # Errors
/// Unauthenticated for a malformed authorization header.
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

/// The hash of the token in the headers, if they have one.
///
/// # Errors
/// As [`bearer`].
pub(super) fn bearer_hash(headers: &HeaderMap) -> Result<Option<String>> {
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
    fn a_bearer_token_is_parsed_and_hidden() {
        for value in [b"Bearer secret123".as_slice(), b"bearer  secret123"] {
            let mut headers = headers(value);
            assert_eq!(bearer_hash(&headers).unwrap(), Some(hash("secret123")));
            hide(&mut headers);
            assert!(!format!("{headers:?}").contains("secret123"));
        }
        assert_eq!(bearer_hash(&HeaderMap::new()).unwrap(), None);
    }

    #[test]
    fn a_malformed_header_is_rejected_without_repeating_it() {
        for value in [b"Basic secret123".as_slice(), b"secret123", b"Bearer", b"Bearer ", b"Bearer secret123\xff", b""]
        {
            let problem = bearer_hash(&headers(value)).unwrap_err().to_string();
            assert!(!problem.contains("secret123"), "{problem}");
        }
    }
}
