//! The identity of a caller: by its token, or anonymous where no token is required. Calls and pages share it. Must not
//! depend on either.

use std::sync::Arc;

use super::{
    caller::Caller,
    token_cache::{Held, TokenCache},
};
use crate::error::{Error, Result};

/// Authenticates callers; clones share the tokens.
#[derive(Debug, Clone)]
pub(super) struct Authenticator {
    tokens: TokenCache,
    /// Whether a caller without a token is rejected.
    required: bool,
}

impl Authenticator {
    pub(super) fn new(tokens: TokenCache, required: bool) -> Self {
        Self { tokens, required }
    }

    /// The token with this hash, if it is in the cache; does not read the disk.
    pub(super) fn known(&self, hash: &str) -> Option<Arc<Held>> {
        self.tokens.known(hash)
    }

    /// The caller with the token whose hash is `shown`, which may be known already.
    ///
    /// # Errors
    /// Unauthenticated for an unknown token, or without a token where one is required.
    pub(super) async fn authenticate(&self, shown: Option<&str>, known: Option<Arc<Held>>) -> Result<Caller> {
        let Some(hash) = shown else {
            return if self.required { Err(no_token()) } else { Ok(Caller::Anyone) };
        };
        let held = match known {
            Some(held) => held,
            None => self.tokens.find(hash).await?.ok_or_else(unknown_token)?,
        };
        self.tokens.used(&held);
        Ok(Caller::Known(held))
    }
}

fn no_token() -> Error {
    Error::unauthenticated(
        "this server requires a token: pass one with --token or GLEANER_TOKEN; the server's operator creates one with \
         `gleaner-server token create`",
    )
}

/// The rejection of an unknown, expired or revoked token; it does not reveal which.
pub(super) fn unknown_token() -> Error {
    Error::unauthenticated(
        "this token is not known, has expired or was revoked; the server's operator creates one with \
         `gleaner-server token create`",
    )
}
