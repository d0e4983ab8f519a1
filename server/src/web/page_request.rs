//! One request of a browser, as the page behind the door sees it: who looks, and the services to look into.

use std::{convert::Infallible, sync::Arc};

use axum::{
    extract::{FromRequestParts, Query},
    http::{Uri, request::Parts},
};
use serde::de::DeserializeOwned;

use super::{AppState, page::Page};
use crate::{
    access::{Caller, PageGuard},
    error::{Error, Result},
    service::Services,
};

/// A request that was let in.
#[derive(Clone)]
pub(super) struct PageRequest {
    pub(super) state: Arc<AppState>,
    pub(super) caller: Caller,
    /// What forms and scripts must bring when they change something.
    pub(super) proof: String,
    pub(super) uri: Uri,
}

impl PageRequest {
    /// The services of the server.
    pub(super) fn services(&self) -> &Services {
        &self.state.services
    }

    /// Whether who looks may also have this page: what they may not do is not offered.
    pub(super) fn may(&self, page: Page) -> bool {
        PageGuard::permit(&self.caller, page).is_ok()
    }

    /// What the address asks for after its `?`.
    ///
    /// # Errors
    /// Invalid, naming the parameter where that is known.
    pub(super) fn parameters<T: DeserializeOwned>(&self) -> Result<T> {
        let query = Query::try_from_uri(&self.uri);
        query.map(|Query(parameters)| parameters).map_err(|rejection| Error::invalid("address", rejection.body_text()))
    }

    /// This address with one parameter set, or left out.
    pub(super) fn with(&self, name: &str, value: Option<&str>) -> String {
        let query = self.uri.query().unwrap_or_default();
        let others = query.split('&').filter(|pair| !pair.is_empty());
        let mut pairs: Vec<String> =
            others.filter(|pair| pair.split('=').next() != Some(name)).map(str::to_owned).collect();
        pairs.extend(value.map(|value| format!("{name}={}", escaped(value))));
        let question = if pairs.is_empty() { "" } else { "?" };
        format!("{}{question}{}", self.uri.path(), pairs.join("&"))
    }
}

/// A text as part of an address.
pub(super) fn escaped(text: &str) -> String {
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || matches!(byte, b'-' | b'_' | b'.' | b'~');
    text.bytes().map(|byte| if plain(byte) { char::from(byte).to_string() } else { format!("%{byte:02X}") }).collect()
}

/// A JSON body.
///
/// # Errors
/// Invalid, saying where it is wrong.
pub(super) fn read<T: DeserializeOwned>(body: &[u8]) -> Result<T> {
    serde_json::from_slice(body).map_err(|error| Error::invalid("body", format!("cannot be read: {error}")))
}

impl<S: Sync> FromRequestParts<S> for PageRequest {
    type Rejection = Infallible;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> std::result::Result<Self, Infallible> {
        // The door puts it there; no route is without the door.
        #[expect(clippy::expect_used, reason = "a route without its door must not serve anything")]
        Ok(parts.extensions.get::<Self>().cloned().expect("every route has its door"))
    }
}
