//! The scorers: one file each, and the list of them.

mod classifier;
mod clock;
mod deminf;
mod kind;
mod list;
mod progress;
mod random;
mod raw;
mod recordings;
mod ssdf;
mod vote;

pub(super) use kind::Scorer;
use kind::{ScorerKind, SeedSpec, Trained, seeded, unmatched, unmatched_each};
pub(crate) use list::describe;
pub(super) use list::open;
