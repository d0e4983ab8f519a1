//! The guard of the pages: authentication, authorisation and audit of their requests.
//!
//! Uses the same tokens, table, log and connections as the guard of calls. Must not depend on the content of pages.

use std::sync::Arc;

use bytes::Bytes;
use gleaner_edge::{Call, ConnectionState};
use http_body::Body;

use super::{
    audit,
    authenticator::Authenticator,
    caller::Caller,
    page::Page,
    refusal_limit::RefusalLimit,
    table::{Need, page_rule},
    token_cache::{LiveToken, TokenCache},
};
use crate::{
    connections::{self, Connections, refused},
    domain::{access::AuditEntry, client::Client, time::Millis},
    error::Result,
    store::Store,
};

/// The guard; clones share it.
#[derive(Clone)]
pub(crate) struct PageGuard {
    authenticator: Authenticator,
    store: Store,
    connections: Connections,
    refusal_limit: Arc<RefusalLimit>,
}

impl PageGuard {
    /// `required`: requests without a token are rejected.
    pub(crate) fn new(tokens: TokenCache, store: Store, required: bool, connections: Connections) -> Self {
        Self {
            authenticator: Authenticator::new(tokens, required),
            store,
            connections,
            refusal_limit: Arc::new(RefusalLimit::new()),
        }
    }

    /// Counts a request for the token with this hash if the token is in the cache, else for the address, and
    /// authenticates its caller. The request counts as running until the returned call is dropped.
    ///
    /// # Errors
    /// Exhausted above the limits of the client; Unauthenticated.
    pub(crate) async fn admit(
        &self,
        hash: Option<&str>,
        connection: &ConnectionState,
    ) -> Result<(Call, Result<Caller>)> {
        let known: Option<Arc<LiveToken>> = hash.and_then(|hash| self.authenticator.known(hash));
        let client = match &known {
            Some(live) => Client::token(&live.token.id),
            None => connections::client(connection),
        };
        let call = self.connections.count(client).map_err(refused)?;
        Ok((call, self.authenticator.authenticate(hash, known).await))
    }

    /// The caller of a request without a token.
    ///
    /// # Errors
    /// Unauthenticated on a server that requires tokens.
    pub(crate) async fn anonymous(&self) -> Result<Caller> {
        self.authenticator.authenticate(None, None).await
    }

    /// The caller with the token of this hash.
    ///
    /// # Errors
    /// Unauthenticated for an unknown token.
    pub(crate) async fn authenticate(&self, hash: &str) -> Result<Caller> {
        self.authenticator.authenticate(Some(hash), None).await
    }

    /// A response body watched by its connection: sent in pieces that must be read, and its call runs until it ends.
    pub(crate) fn watched<B: Body<Data = Bytes> + Unpin>(
        &self,
        body: B,
        connection: &ConnectionState,
        call: Call,
    ) -> impl Body<Data = Bytes, Error = B::Error> + use<B> {
        self.connections.response(body, connection, call)
    }

    /// Counts a refusal by role; returns whether the audit log records it.
    pub(crate) fn records_refusal(&self, caller: &Caller) -> bool {
        self.refusal_limit.records(caller)
    }

    /// Checks that the caller may request a page.
    ///
    /// # Errors
    /// Forbidden, naming the role that is needed.
    pub(crate) fn permit(caller: &Caller, page: Page) -> Result<()> {
        caller.permit(page_rule(page).need)
    }

    /// Whether this page is public.
    pub(crate) fn is_open(page: Page) -> bool {
        page_rule(page).need == Need::Nothing
    }

    /// Whether a request for this page changes something and is audited.
    pub(crate) fn changes(page: Page) -> bool {
        page_rule(page).audited
    }

    /// Writes a change, or a refused one, to the audit log; completes once the entry is on disk, as [`audit::write`].
    pub(crate) async fn note(&self, caller: &Caller, connection: &ConnectionState, done: Done) {
        let Done { page, subjects, outcome } = done;
        let entry = AuditEntry {
            at: Millis::now(),
            token_id: caller.token_id(),
            who: caller.name().to_owned(),
            peer: connection.peer().to_string(),
            rpc: format!("pages/{page:?}"),
            subjects,
            outcome,
        };
        audit::write(self.store.clone(), entry).await;
    }
}

/// A change by a page.
pub(crate) struct Done {
    /// The page.
    pub(crate) page: Page,
    /// The subjects, as `field=value`.
    pub(crate) subjects: Vec<String>,
    /// `ok`, or the reason of the refusal.
    pub(crate) outcome: String,
}
