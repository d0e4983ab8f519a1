//! The identity of a caller: by its token, or anonymous where no token is required. Calls and pages share it. Must not
//! depend on either.

use std::sync::Arc;

use super::{
    caller::Caller,
    token_cache::{LiveToken, TokenCache},
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
    pub(super) fn known(&self, hash: &str) -> Option<Arc<LiveToken>> {
        self.tokens.known(hash)
    }

    /// The caller with the token of this hash, or the anonymous caller without one. `known`: the token, if it was in the
    /// cache.
    ///
    /// # Errors
    /// Unauthenticated for an unknown token, or without a token where one is required.
    pub(super) async fn authenticate(&self, hash: Option<&str>, known: Option<Arc<LiveToken>>) -> Result<Caller> {
        let Some(hash) = hash else {
            return if self.required { Err(no_token()) } else { Ok(Caller::Anyone) };
        };
        let live = match known {
            Some(live) => live,
            None => self.tokens.find(hash).await?.ok_or_else(unknown_token)?,
        };
        self.tokens.used(&live);
        Ok(Caller::Known(live))
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
        "this token is unknown, expired or revoked; the server's operator creates one with \
         `gleaner-server token create`",
    )
}
