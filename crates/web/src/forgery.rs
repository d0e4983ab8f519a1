//! Protection against forged requests: the proof that a change comes from a page of this server, and the host name of a
//! request. Must not know who the caller is.

use axum::{
    body::Body,
    extract::Request,
    http::{HeaderMap, header::HOST},
};
use gleaner_core::{Error, Result};

use super::{AppState, change::is_form};

/// The header with the proof that a request comes from one of our scripts.
const PROOF: &str = "x-gleaner-proof";

/// Reads the whole body; if a proof is required, checks that the request comes from our own page: from a script in a
/// header, from a form in a field.
///
/// # Errors
/// Forbidden; Invalid when the body is too large or incomplete.
pub(super) async fn checked(request: Request, most: usize, proof: Option<&str>) -> Result<Request> {
    let (parts, body) = request.into_parts();
    let body = axum::body::to_bytes(body, most).await.map_err(|_| {
        Error::invalid("body", format!("is incomplete or larger than {most} bytes; send fewer items at a time"))
    })?;
    if let Some(proof) = proof
        && sent_proof(&parts.headers, &body) != Some(proof)
    {
        return Err(Error::forbidden("the request's proof is missing or expired; reload the page and retry"));
    }
    Ok(Request::from_parts(parts, Body::from(body)))
}

/// The proof in a request.
fn sent_proof<'a>(headers: &'a HeaderMap, body: &'a [u8]) -> Option<&'a str> {
    let in_header = headers.get(PROOF).and_then(|value| value.to_str().ok());
    let in_form = || {
        let pairs = std::str::from_utf8(body).unwrap_or_default().split('&').filter_map(|pair| pair.split_once('='));
        pairs.into_iter().find(|(name, _)| *name == "proof").map(|(_, value)| value)
    };
    in_header.or_else(|| if is_form(headers) { in_form() } else { None })
}

impl AppState {
    /// Checks the host name of a request. Without tokens, a foreign site's name that resolves to this address would let
    /// that site read every page (DNS rebinding).
    ///
    /// # Errors
    /// Forbidden.
    pub(super) fn expects(&self, headers: &HeaderMap) -> Result<()> {
        let host = headers.get(HOST).and_then(|value| value.to_str().ok()).unwrap_or_default();
        let name = host
            .rsplit_once(':')
            .map_or(host, |(name, port)| if port.bytes().all(|byte| byte.is_ascii_digit()) { name } else { host });
        let name = name.trim_start_matches('[').trim_end_matches(']');
        let here = name == "localhost" || name.parse::<std::net::IpAddr>().is_ok();
        if here || !self.loopback {
            return Ok(());
        }
        Err(Error::forbidden(format!(
            "pages are served at localhost and 127.0.0.1 only, not at {}; configure the proxy to use one of them",
            name.escape_debug()
        )))
    }
}
