//! Who may do what: one table of rpcs, pages and roles, tokens, the guard before the services, certificates, and the
//! audit log.
//!
//! Knows requests by their path and headers, and of their messages only names and ids. Must not know what an rpc does.

mod answer;
mod asked;
mod book;
mod caller;
pub mod command;
mod entry;
mod guard;
mod mint;
mod overheard;
mod page;
mod pages;
mod reception;
mod refusals;
mod secret;
mod subject;
mod table;
pub mod tls;
mod worker;

pub(crate) use self::{
    book::Book,
    caller::Caller,
    guard::Guard,
    page::Page,
    pages::{Done, PageGuard},
    secret::hash as token_hash,
    table::method,
    worker::Worker,
};
