//! Authentication and limits of requests for pages, with the tokens and connections of calls. Must not depend on the
//! content of pages.

use std::sync::Arc;

use gleaner_edge::{Call, ConnectionState};

use super::{
    authenticator::Authenticator,
    caller::Caller,
    refusal_limit::RefusalLimit,
    token_cache::{LiveToken, TokenCache},
};
use crate::{
    connections::{self, Connections, refused},
    domain::{client::Client, id::TokenId},
    error::Result,
};

/// The guard of the pages.
pub(crate) struct PageGuard {
    authenticator: Authenticator,
    connections: Connections,
    refusal_limit: RefusalLimit,
}

impl PageGuard {
    /// `required`: whether a caller without a token is rejected.
    pub(crate) fn new(tokens: TokenCache, required: bool, connections: Connections) -> Self {
        Self { authenticator: Authenticator::new(tokens, required), connections, refusal_limit: RefusalLimit::new() }
    }

    /// Counts a request for the token with the hash `shown` if that is known, else for the address; and authenticates
    /// it. The request counts until the call is dropped.
    ///
    /// # Errors
    /// Exhausted when there are too many; the inner result as [`PageGuard::authenticate`].
    pub(crate) async fn admit(
        &self,
        shown: Option<&str>,
        connection: &ConnectionState,
    ) -> Result<(Call, Result<Caller>)> {
        let known: Option<Arc<LiveToken>> = shown.and_then(|hash| self.authenticator.known(hash));
        let client = match &known {
            Some(live) => Client::token(&live.token.id),
            None => connections::client(connection),
        };
        let call = self.connections.count(client).map_err(refused)?;
        Ok((call, self.authenticator.authenticate(shown, known).await))
    }

    /// The caller with the token of this hash, or without one.
    ///
    /// # Errors
    /// Unauthenticated for an unknown token, and without a token where one is required.
    pub(crate) async fn authenticate(&self, shown: Option<&str>) -> Result<Caller> {
        self.authenticator.authenticate(shown, None).await
    }

    /// Whether one more rejected change of this token is audited.
    pub(crate) fn audits_rejection(&self, token: &TokenId) -> bool {
        self.refusal_limit.records_token(token)
    }
}
