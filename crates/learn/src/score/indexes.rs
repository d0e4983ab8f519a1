//! The indexes of experts that a run compares queries with. Must not depend on where features come from.

use std::collections::HashSet;

use gleaner_search::{Index, Match, Metric};

use super::alike::Copies;
use super::features::Features;
use super::form::Matches;
use crate::error::LearnError;

/// The experts as indexes, each recording once.
pub(super) struct Indexes {
    all: Index,
    /// The recordings that the earlier run lacks; `None` if it lacks none, or without an earlier run.
    pub(super) new: Option<Index>,
    pub(super) copies: Copies,
}

impl Indexes {
    /// The indexes of experts with these `features`, by number; the earlier run `had` some of the numbers.
    pub(super) fn new(features: &[Features], had: &HashSet<u32>, metric: Metric) -> Result<Self, LearnError> {
        let copies = Copies::among(features);
        let distinct = copies.distinct(features);
        let new: Vec<(u32, &Features)> = distinct.iter().filter(|(number, _)| !had.contains(number)).copied().collect();
        let all = Index::new(&distinct, metric)?;
        let new = (!had.is_empty() && !new.is_empty()).then(|| Index::new(&new, metric)).transpose()?;
        Ok(Self { all, new, copies })
    }

    /// The nearest expert segments of the `queries` of an episode, outside the recording of expert `own`, given those that
    /// are `known` from an earlier run; `None` if no expert is left. Known matches within that recording do not count.
    pub(super) fn nearest(
        &self,
        queries: &Features,
        own: Option<u32>,
        known: Option<Vec<Option<Match>>>,
    ) -> Result<Matches, LearnError> {
        let own = own.map(|own| self.copies.first(own));
        Ok(match (known.filter(|known| own.is_none_or(|own| !self.are_within(own, known))), &self.new) {
            (None, _) => self.all.nearest(queries, own)?,
            (Some(mut known), new) => {
                if let Some(new) = new {
                    new.improve(queries, own, &mut known)?;
                }
                known.into_iter().collect()
            }
        })
    }

    /// Whether any of these matches is within the recording of expert `own`.
    pub(super) fn are_within(&self, own: u32, known: &[Option<Match>]) -> bool {
        let own = self.copies.first(own);
        known.iter().flatten().any(|found| self.copies.first(found.group) == own)
    }
}
