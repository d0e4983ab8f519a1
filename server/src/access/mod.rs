//! Who may do what: one table of rpcs and roles, tokens, the guard before the services, certificates, and the
//! audit log.
//!
//! Knows requests by their path and headers, and of their messages only names and ids. Must not know what an rpc does.

mod answer;
mod asked;
mod authenticator;
mod caller;
pub mod command;
mod entry;
mod guard;
mod issue;
mod overheard;
mod pages;
mod refusals;
mod secret;
mod span;
mod subject;
mod table;
pub mod tls;
mod token_cache;
mod worker;

pub(crate) use self::{
    caller::Caller, guard::Guard, pages::PageGuard, secret::hash as token_hash, table::method, token_cache::TokenCache,
    worker::Worker,
};
