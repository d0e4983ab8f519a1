//! The guard of the pages: who looks, what they may see and change, and what of it the audit log hears.
//!
//! The same tokens, table, log and connections as for calls. Knows no page's content.

use std::sync::Arc;

use bytes::Bytes;
use gleaner_edge::{Call, ConnectionState};
use http_body::Body;

use super::{
    authenticator::Authenticator,
    caller::Caller,
    page::Page,
    refusals::Refusals,
    table::{Need, page_rule},
    token_cache::{Held, TokenCache},
};
use crate::{
    connections::{self, Connections, refused},
    domain::{access::AuditEntry, client::Client, time::Millis},
    error::Result,
    store::Store,
};

/// Stands before the pages.
#[derive(Clone)]
pub(crate) struct PageGuard {
    authenticator: Authenticator,
    store: Store,
    connections: Connections,
    refusals: Arc<Refusals>,
}

impl PageGuard {
    /// `required`: whether who shows no token is sent away.
    pub(crate) fn new(tokens: TokenCache, store: Store, required: bool, connections: Connections) -> Self {
        Self {
            authenticator: Authenticator::new(tokens, required),
            store,
            connections,
            refusals: Arc::new(Refusals::new()),
        }
    }

    /// Counts a request for the token with the hash `shown` if that is known, else for the address; and says who it is.
    /// The request counts as under way until what is given first is dropped.
    ///
    /// # Errors
    /// Exhausted when there are too many; Unauthenticated.
    pub(crate) async fn admit(
        &self,
        shown: Option<&str>,
        connection: &ConnectionState,
    ) -> Result<(Call, Result<Caller>)> {
        let known: Option<Arc<Held>> = shown.and_then(|hash| self.authenticator.known(hash));
        let client = match &known {
            Some(held) => Client::token(&held.token.id),
            None => connections::client(connection),
        };
        let call = self.connections.count(client).map_err(refused)?;
        Ok((call, self.authenticator.authenticate(shown, known).await))
    }

    /// Who it is that shows no token.
    ///
    /// # Errors
    /// Unauthenticated where one is asked for.
    pub(crate) async fn nobody(&self) -> Result<Caller> {
        self.authenticator.authenticate(None, None).await
    }

    /// Who it is that shows the token with this hash.
    ///
    /// # Errors
    /// Unauthenticated when it is none of ours.
    pub(crate) async fn known(&self, hash: &str) -> Result<Caller> {
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

    /// Whether the audit log hears of one more refusal.
    pub(crate) fn tells_of_refusal(&self, caller: &Caller) -> bool {
        self.refusals.tell_of(caller)
    }

    /// Lets somebody look at a page, or change something with it.
    ///
    /// # Errors
    /// Forbidden, naming the role that is needed.
    pub(crate) fn permit(caller: &Caller, page: Page) -> Result<()> {
        caller.permit(page_rule(page).need)
    }

    /// Whether anybody may have this page, whoever they are.
    pub(crate) fn is_open(page: Page) -> bool {
        page_rule(page).need == Need::Nothing
    }

    /// Whether a request for this page changes something.
    pub(crate) fn changes(page: Page) -> bool {
        page_rule(page).audited
    }

    /// Writes a change, or one that was refused, to the audit log. Ends when it is on disk, and is written also if nobody
    /// waits for that. One that cannot be written undoes nothing; the log has it instead.
    pub(crate) async fn note(&self, caller: &Caller, connection: &ConnectionState, done: Done) {
        let entry = AuditEntry {
            at: Millis::now(),
            token_id: caller.token_id(),
            who: caller.who().to_owned(),
            peer: connection.peer().to_string(),
            rpc: format!("pages/{:?}", done.page),
            subjects: done.subjects,
            outcome: done.outcome,
        };
        let store = self.store.clone();
        let writing = tokio::spawn(async move {
            if let Err(error) = store.insert_audit(&entry).await {
                tracing::error!(
                    %error, audit.rpc = entry.rpc, audit.who = entry.who, audit.subjects = ?entry.subjects,
                    audit.outcome = entry.outcome, "the audit log could not be written"
                );
            }
        });
        // It fails only with the runtime.
        let _ = writing.await;
    }
}

/// What was done with a page.
pub(crate) struct Done {
    /// The page.
    pub(crate) page: Page,
    /// What it was about, as `field=value`.
    pub(crate) subjects: Vec<String>,
    /// `ok`, or what it was refused as.
    pub(crate) outcome: String,
}
