//! What the pages ask of the database beyond what the services do: one question, one file.

mod episode;
mod lineage;
mod overview;
mod retry;
mod snapshot;
mod table;

pub(super) use self::retry::expect_none_alike;
