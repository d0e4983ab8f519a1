//! The scorers: one file each, and the list of them.

mod kind;
mod list;
mod raw;
mod ssdf;

pub(super) use kind::{Scorer, ScorerKind};
pub(crate) use list::describe;
pub(super) use list::open;
