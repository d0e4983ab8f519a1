//! Counts of the segments that selections keep: in total, by cohort and by episode. Must not depend on rows.

use std::collections::BTreeMap;

use super::{Candidate, ExpertRanking, Resolved, Selection};
use crate::id::EpisodeId;

/// The kept part of a group of imperfect episodes.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Kept {
    /// Segments kept.
    pub segments: u64,
    /// Segments in the group.
    pub of_segments: u64,
    /// Episodes that contribute at least one.
    pub episodes: u64,
    /// Episodes in the group.
    pub of_episodes: u64,
}

impl Kept {
    fn add(&mut self, kept: u64, of: u64) {
        self.segments += kept;
        self.of_segments += of;
        self.episodes += u64::from(kept > 0);
        self.of_episodes += 1;
    }
}

/// The part of a run that one selection would keep.
#[derive(Debug, Clone, PartialEq)]
pub struct WhatIf {
    /// The selection.
    pub selection: Selection,
    /// The lowest kept w; `None` when no segment is kept.
    pub threshold: Option<f64>,
    /// Sums over all imperfect episodes.
    pub total: Kept,
    /// Sums by cohort.
    pub cohorts: BTreeMap<String, Kept>,
    /// Each episode with its kept segments and its segments, in the snapshot's order.
    pub episodes: Vec<(EpisodeId, u64, u64)>,
}

/// The part that one selection would keep of the run's imperfect episodes, given in the snapshot's order. `ranked` and
/// `ranking` are as for [`Resolved::new`].
pub fn what_if(
    selection: Selection,
    ranked: &[(f32, f64)],
    candidates: &[Candidate],
    ranking: &ExpertRanking,
) -> WhatIf {
    let (resolved, mut marked) = (Resolved::new(selection, ranked, candidates, ranking), Vec::new());
    let (mut total, mut threshold) = (Kept::default(), None::<f64>);
    let (mut cohorts, mut episodes) = (BTreeMap::<String, Kept>::new(), Vec::with_capacity(candidates.len()));
    for candidate in candidates {
        let of = candidate.w.len() as u64;
        let (kept, lowest) = resolved.count(candidate, &mut marked);
        threshold = lowest.map(|w| threshold.map_or(w, |before| before.min(w))).or(threshold);
        total.add(kept, of);
        match cohorts.get_mut(&candidate.cohort) {
            Some(cohort) => cohort.add(kept, of),
            None => cohorts.entry(candidate.cohort.clone()).or_default().add(kept, of),
        }
        episodes.push((candidate.episode_id.clone(), kept, of));
    }
    WhatIf { selection, threshold, total, cohorts, episodes }
}
