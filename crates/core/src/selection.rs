//! Selections: the imperfect segments of a score run to keep, and the counts that other selections would keep.
//!
//! A selection is a [`Rule`] on the scores and a [`SelectionShape`] of what the rule keeps. [`Resolved`] applies both,
//! for every reader of kept segments: counts, datasets, trainings, exports and experiments. Must not depend on rows,
//! messages or pages.

mod count;
mod expert_ranking;
mod phase;
mod rule;
mod shape;

pub use count::{Kept, WhatIf, what_if};
pub use expert_ranking::ExpertRanking;
pub use phase::places;
pub use rule::{Filter, Rule, best_first, ranked};
pub use shape::SelectionShape;

use std::{cmp::Ordering, collections::BTreeSet};

use super::id::EpisodeId;
use phase::Cuts;

/// The imperfect segments to keep.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Selection {
    /// Decides from a segment's scores.
    #[serde(flatten)]
    pub rule: Rule,
    /// Decides from the segments around it, and from how many are kept.
    #[serde(skip_serializing_if = "SelectionShape::is_off")]
    pub shape: SelectionShape,
}

impl Selection {
    /// The segments with q > β, without a shape.
    pub fn beta(beta: f64) -> Self {
        Rule::Beta(beta).into()
    }

    /// The best part of the segments, without a shape.
    pub fn top_fraction(fraction: f64) -> Self {
        Rule::TopFraction(fraction).into()
    }

    /// Whether it limits phases, so that [`Resolved::new`] reads the candidates with their places.
    pub fn limits_phases(&self) -> bool {
        self.shape.max_per_phase > 0
    }

    /// Whether it leaves out cohorts by how they rank beside experts, so that [`Resolved::new`] reads that ranking.
    pub fn reads_ranking(&self) -> bool {
        self.shape.min_expert_auroc > 0.0
    }
}

impl From<Rule> for Selection {
    fn from(rule: Rule) -> Self {
        Self { rule, shape: SelectionShape::default() }
    }
}

/// One imperfect episode of a run, with the values that a selection reads. Every list has one entry a step.
#[derive(Debug, Clone)]
pub struct Candidate {
    /// The episode.
    pub episode_id: EpisodeId,
    /// Its cohort in the run's snapshot.
    pub cohort: String,
    /// w of every segment.
    pub w: Vec<f64>,
    /// q of every segment.
    pub q: Vec<f32>,
    /// The place of every segment in the task, from [`places`]; empty where the scorer matches nothing, so that the place
    /// in the episode counts. Only a limit of phases reads it.
    pub places: Vec<u32>,
}

/// One segment, in the order in which limits keep segments.
#[derive(Debug, Clone, Copy)]
struct Ranked<'a> {
    q: f32,
    w: f64,
    episode: &'a EpisodeId,
    end_step: usize,
}

impl Ranked<'_> {
    /// The better first: by q, then by w, then by older episode and earlier step. Two segments are never equal.
    fn order(&self, other: &Self) -> Ordering {
        let by_score = other.q.total_cmp(&self.q).then(other.w.total_cmp(&self.w));
        by_score.then_with(|| self.episode.cmp(other.episode)).then(self.end_step.cmp(&other.end_step))
    }
}

impl Candidate {
    fn ranked(&self, end_step: usize) -> Ranked<'_> {
        Ranked { q: self.q[end_step], w: self.w[end_step], episode: &self.episode_id, end_step }
    }
}

/// A selection resolved for one run: decides which segments of each of its imperfect episodes are kept.
///
/// The order is fixed: cohorts, the rule, gaps, short runs, context, the limit of an episode, the limit of a phase. The kept
/// segments do not depend on the order of the episodes.
#[derive(Debug)]
pub struct Resolved<'a> {
    filter: Filter,
    shape: SelectionShape,
    /// The cohorts of which nothing is kept.
    left_out: BTreeSet<String>,
    cuts: Option<Cuts<'a>>,
}

impl<'a> Resolved<'a> {
    /// `ranked` is the (q, w) of all the run's imperfect segments from best to worst, which only a top fraction reads.
    /// `candidates` are all the run's imperfect episodes in any order, which only a limit of phases reads. `ranking` is the
    /// run's, which only [`Selection::reads_ranking`] reads.
    pub fn new(
        selection: Selection,
        ranked: &[(f32, f64)],
        candidates: &'a [Candidate],
        ranking: &ExpertRanking,
    ) -> Self {
        let Selection { rule, shape } = selection;
        let left_out = ranking.below(shape.min_expert_auroc).map(ToOwned::to_owned).collect();
        // Of the cohorts that are left the rest of the shape decides.
        let shape = SelectionShape { min_expert_auroc: 0.0, ..shape };
        let mut resolved = Self { filter: Filter::new(rule, ranked), shape, left_out, cuts: None };
        if selection.limits_phases() {
            resolved.cuts = Some(Cuts::new(&shape, candidates, |candidate, kept| resolved.mark(candidate, kept)));
        }
        resolved
    }

    /// Sets `kept` to whether each segment of the episode is kept, by end step.
    pub fn mark(&self, candidate: &Candidate, kept: &mut Vec<bool>) {
        kept.clear();
        if self.left_out.contains(&candidate.cohort) {
            kept.resize(candidate.w.len(), false);
            return;
        }
        kept.extend(candidate.w.iter().zip(&candidate.q).map(|(&w, &q)| self.filter.keeps(w, q)));
        self.shape.apply(candidate, kept);
        if let Some(cuts) = &self.cuts {
            cuts.apply(candidate, kept);
        }
    }
}

impl Resolved<'_> {
    /// The number of kept segments of an episode and the lowest w of them. Most selections decide by a segment's own
    /// scores; of millions of segments, these are then counted without being marked. `marked` is memory for the others.
    fn count(&self, candidate: &Candidate, marked: &mut Vec<bool>) -> (u64, Option<f64>) {
        let scores = candidate.w.iter().copied().zip(candidate.q.iter().copied());
        let (mut kept, mut lowest) = (0, f64::INFINITY);
        if self.left_out.contains(&candidate.cohort) {
            return (0, None);
        }
        // Without branches: which of the segments are kept cannot be predicted.
        let mut add = |w: f64, keeps: bool| {
            kept += u64::from(keeps);
            lowest = lowest.min(if keeps { w } else { f64::INFINITY });
        };
        if self.shape.is_off() {
            scores.for_each(|(w, q)| add(w, self.filter.keeps(w, q)));
        } else {
            self.mark(candidate, marked);
            scores.zip(&*marked).for_each(|((w, _), &keeps)| add(w, keeps));
        }
        (kept, (kept > 0).then_some(lowest))
    }
}

#[cfg(test)]
mod tests;
