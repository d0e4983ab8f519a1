//! Access control: one table of rpcs and roles, tokens, the guard before the services, certificates, and the audit log.
//!
//! Depends on the path and the headers of requests, not on their messages: services name the subjects of a change. Must
//! not depend on what an rpc does.

mod audit;
mod authenticator;
mod caller;
pub mod command;
mod guard;
mod issue;
mod page_guard;
mod refusal_limit;
mod request_body;
mod response_body;
mod secret;
mod span;
mod subjects;
mod table;
pub mod tls;
mod token_cache;
mod worker;

#[cfg(test)]
pub(crate) use self::table::audited;
pub(crate) use self::{
    audit::{AuditDraft, write as write_audit},
    caller::Caller,
    guard::Guard,
    page_guard::PageGuard,
    secret::hash as token_hash,
    subjects::{Named, Subjects},
    table::method,
    token_cache::TokenCache,
    worker::Worker,
};
