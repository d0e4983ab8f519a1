//! Queries of the pages beyond those of the services: one query, one file.

mod episode;
mod lineage;
mod overview;
mod retry;
mod snapshot;
mod table;

pub(super) use self::retry::expect_none_alike;
