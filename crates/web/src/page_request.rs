//! One request of a browser, as its page sees it: the caller and the backend.

use std::{convert::Infallible, sync::Arc};

use axum::{
    extract::{FromRequestParts, Query},
    http::{Uri, request::Parts},
};
use gleaner_core::{Error, Result};
use serde::de::DeserializeOwned;

use super::{AppState, Backend, Caller, audit_draft::AuditDraft, page::Page};

/// A request that has passed the middleware.
#[derive(Clone)]
pub(super) struct PageRequest {
    pub(super) state: Arc<AppState>,
    pub(super) caller: Caller,
    /// The audit entry, if the page changes something.
    pub(super) audit: AuditDraft,
    /// The proof that forms and scripts must send with a change.
    pub(super) proof: String,
    /// Whether a program rather than a person reads the response.
    pub(super) data: bool,
    pub(super) uri: Uri,
}

impl PageRequest {
    /// The server.
    pub(super) fn backend(&self) -> &dyn Backend {
        &*self.state.backend
    }

    /// Whether the caller may also request this page; links to others are not shown.
    pub(super) fn may(&self, page: Page) -> bool {
        self.caller.permit(page).is_ok()
    }

    /// The query of the address.
    ///
    /// # Errors
    /// Invalid, naming the parameter if it is known.
    pub(super) fn parameters<T: DeserializeOwned>(&self) -> Result<T> {
        let query = Query::try_from_uri(&self.uri);
        query.map(|Query(parameters)| parameters).map_err(|rejection| Error::invalid("address", rejection.body_text()))
    }

    /// This address with one parameter set or removed.
    pub(super) fn with(&self, name: &str, value: Option<&str>) -> String {
        let query = self.uri.query().unwrap_or_default();
        let others = query.split('&').filter(|pair| !pair.is_empty());
        let mut pairs: Vec<String> =
            others.filter(|pair| pair.split('=').next() != Some(name)).map(str::to_owned).collect();
        pairs.extend(value.map(|value| format!("{name}={}", escaped(value))));
        let question = if pairs.is_empty() { "" } else { "?" };
        format!("{}{question}{}", self.uri.path(), pairs.join("&"))
    }

    /// This request without one parameter of its address.
    pub(super) fn without(&self, name: &str) -> Self {
        let uri = self.with(name, None).parse().unwrap_or_else(|_| self.uri.clone());
        Self { uri, ..self.clone() }
    }
}

/// Escapes a text for an address.
pub(super) fn escaped(text: &str) -> String {
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || matches!(byte, b'-' | b'_' | b'.' | b'~');
    text.bytes().map(|byte| if plain(byte) { char::from(byte).to_string() } else { format!("%{byte:02X}") }).collect()
}

/// Parses a JSON body.
///
/// # Errors
/// Invalid, with the place of the error.
pub(super) fn read<T: DeserializeOwned>(body: &[u8]) -> Result<T> {
    serde_json::from_slice(body).map_err(|error| Error::invalid("body", format!("cannot be parsed: {error}")))
}

impl<S: Sync> FromRequestParts<S> for PageRequest {
    type Rejection = Infallible;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> std::result::Result<Self, Infallible> {
        // Set by the middleware, which every route has.
        #[expect(clippy::expect_used, reason = "a route without its middleware must not serve any page")]
        Ok(parts.extensions.get::<Self>().cloned().expect("every route has its middleware"))
    }
}
