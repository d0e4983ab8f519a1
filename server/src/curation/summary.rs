//! A finished run in memory: q and w of its imperfect segments, q of its experts, and derived statistics. A finished
//! run never changes.

use std::{
    cmp::Ordering,
    collections::HashMap,
    sync::{Arc, OnceLock},
};

use quick_cache::Weighter;

use super::{RUN_BYTES, off_runtime};
use crate::{
    domain::{
        curation::SegmentRef,
        id::{EpisodeId, ScoreRunId},
        score::{Histogram, ScoreRun},
        selection::{Candidate, ExpertRanking, Rule, Selection, WhatIf, ranked, what_if},
    },
    error::Result,
};

/// The number of best and worst segments shown.
const FOREMOST: usize = 24;
/// Maximum number of segments of one episode among the best or the worst.
const OF_ONE_EPISODE: usize = 3;
/// The least distance in steps between shown segments of one episode: neighbours look alike.
const APART: usize = 10;

/// A run's scores of its imperfect episodes.
pub(crate) struct Summary {
    run: ScoreRun,
    candidates: Vec<Candidate>,
    /// q of each expert.
    experts: Vec<Vec<f32>>,
    places: HashMap<EpisodeId, usize>,
    mean_q: Vec<Option<f64>>,
    /// (q, w) from best to worst; built on the first request for a top fraction. The fields below are also built on
    /// demand.
    ranked: OnceLock<Vec<(f32, f64)>>,
    histogram: OnceLock<Histogram>,
    expert_ranking: OnceLock<ExpertRanking>,
    best: OnceLock<Vec<SegmentRef>>,
    worst: OnceLock<Vec<SegmentRef>>,
}

impl Summary {
    pub(super) fn new(run: ScoreRun, candidates: Vec<Candidate>, experts: Vec<Vec<f32>>) -> Self {
        let places = candidates.iter().map(|one| one.episode_id.clone()).zip(0..).collect();
        let mean_q = candidates.iter().map(|one| mean(&one.q)).collect();
        let (ranked, histogram, expert_ranking, best, worst) = Default::default();
        Self { run, candidates, experts, places, mean_q, ranked, histogram, expert_ranking, best, worst }
    }

    /// The run.
    pub(crate) fn run(&self) -> &ScoreRun {
        &self.run
    }

    /// The counts of a selection.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn what_if(self: &Arc<Self>, selection: Selection) -> Result<WhatIf> {
        let summary = Arc::clone(self);
        let counting = move || {
            let ranked = match selection.rule {
                Rule::Beta(_) => &[],
                Rule::TopFraction(_) => summary.ranked.get_or_init(|| ranked(&summary.candidates)).as_slice(),
            };
            let unread = ExpertRanking::default();
            let ranking = if selection.reads_ranking() { summary.ranking() } else { &unread };
            Ok(what_if(selection, ranked, &summary.candidates, ranking))
        };
        off_runtime("counting what is kept", counting).await
    }

    /// The distributions of q in `bins` equal bins over [0, 1]. Those of the first number of bins are kept.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn histogram(self: &Arc<Self>, bins: usize) -> Result<Histogram> {
        if let Some(kept) = self.histogram.get().filter(|kept| kept.counts().len() == bins) {
            return Ok(kept.clone());
        }
        let filled = self.fill(Histogram::new(bins, &[])).await?;
        // Another number of bins may be kept already.
        let _kept = self.histogram.set(filled.clone());
        Ok(filled)
    }

    /// Fills an empty histogram with the q of the run's imperfect segments and of its experts.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn fill(self: &Arc<Self>, mut histogram: Histogram) -> Result<Histogram> {
        let summary = Arc::clone(self);
        let counting = move || {
            summary.candidates.iter().for_each(|one| histogram.add(&one.cohort, one.q.iter().copied()));
            summary.experts.iter().for_each(|q| histogram.add_expert(q.iter().copied()));
            Ok(histogram)
        };
        off_runtime("making a histogram", counting).await
    }

    /// How often q ranks experts above imperfect segments.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn expert_ranking(self: &Arc<Self>) -> Result<ExpertRanking> {
        let summary = Arc::clone(self);
        off_runtime("comparing experts", move || Ok(summary.ranking().clone())).await
    }

    /// The same, on this thread.
    fn ranking(&self) -> &ExpertRanking {
        self.expert_ranking.get_or_init(|| ExpertRanking::of_candidates(&self.candidates, self.experts.concat()))
    }

    /// The best segments in order: by q, then by w, then by older episode and earlier step. At most 3 of one episode,
    /// 10 steps apart, and 24 in all.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn best(self: &Arc<Self>, most: usize) -> Result<Vec<SegmentRef>> {
        self.foremost(most, |summary| &summary.best, |a, b| b.0.total_cmp(&a.0).then(b.1.total_cmp(&a.1))).await
    }

    /// The worst segments, the worst first; otherwise as [`Summary::best`].
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn worst(self: &Arc<Self>, most: usize) -> Result<Vec<SegmentRef>> {
        self.foremost(most, |summary| &summary.worst, |a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1))).await
    }

    /// Computes all derived statistics ahead of their first use.
    ///
    /// # Errors
    /// Internal.
    pub(super) async fn warm(self: &Arc<Self>) -> Result<()> {
        self.what_if(Selection::top_fraction(1.0)).await?;
        self.expert_ranking().await?;
        self.best(1).await?;
        self.worst(1).await?;
        Ok(())
    }

    /// Mean q of an episode's segments; `None` when it is not an imperfect episode of the run.
    pub(crate) fn mean_q(&self, episode: &EpisodeId) -> Option<f64> {
        self.places.get(episode).and_then(|&place| self.mean_q[place])
    }

    async fn foremost(
        self: &Arc<Self>,
        most: usize,
        kept: fn(&Self) -> &OnceLock<Vec<SegmentRef>>,
        order: Order,
    ) -> Result<Vec<SegmentRef>> {
        let summary = Arc::clone(self);
        let looking = move || {
            let found = kept(&summary).get_or_init(|| foremost(&summary.candidates, FOREMOST, order));
            Ok(found.iter().take(most).cloned().collect())
        };
        off_runtime("looking for the best and worst", looking).await
    }
}

/// An order of (q, w): less comes first.
type Order = fn(&(f32, f64), &(f32, f64)) -> Ordering;

fn mean(q: &[f32]) -> Option<f64> {
    #[expect(clippy::cast_precision_loss, reason = "far fewer than 2^52 steps")]
    let steps = q.len() as f64;
    (!q.is_empty()).then(|| q.iter().copied().map(f64::from).sum::<f64>() / steps)
}

/// The first segments in this order.
fn foremost(candidates: &[Candidate], most: usize, order: Order) -> Vec<SegmentRef> {
    let compare = |a: &(&Candidate, usize), b: &(&Candidate, usize)| {
        let by_score = order(&scores(a.0, a.1), &scores(b.0, b.1));
        by_score.then_with(|| a.0.episode_id.cmp(&b.0.episode_id)).then(a.1.cmp(&b.1))
    };
    // An episode has a segment among the first ones only if its own first segment is.
    let mut firsts: Vec<(&Candidate, usize)> =
        candidates.iter().filter_map(|one| Some((one, next(one, &[], order)?))).collect();
    firsts.sort_unstable_by(compare);
    firsts.truncate(most);
    let mut found: Vec<(&Candidate, usize)> = Vec::new();
    for (candidate, first) in firsts {
        let mut chosen = vec![first];
        while chosen.len() < OF_ONE_EPISODE
            && let Some(step) = next(candidate, &chosen, order)
        {
            chosen.push(step);
        }
        found.extend(chosen.into_iter().map(|step| (candidate, step)));
    }
    found.sort_unstable_by(compare);
    found.truncate(most);
    let segment = |(candidate, step): (&Candidate, usize)| SegmentRef {
        episode_id: candidate.episode_id.clone(),
        end_step: u32::try_from(step).unwrap_or(u32::MAX),
        q: candidate.q[step],
    };
    found.into_iter().map(segment).collect()
}

/// The first step of an episode in this order, at a distance from the chosen ones; of equal steps the earliest.
fn next(candidate: &Candidate, chosen: &[usize], order: Order) -> Option<usize> {
    let free = (0..candidate.q.len()).filter(|step| chosen.iter().all(|other| other.abs_diff(*step) >= APART));
    free.min_by(|&a, &b| order(&scores(candidate, a), &scores(candidate, b)))
}

fn scores(candidate: &Candidate, step: usize) -> (f32, f64) {
    (candidate.q[step], candidate.w[step])
}

/// The memory of a summary: its scores, and the ranking that may still be built.
#[derive(Debug, Clone)]
pub(super) struct Weigh;

impl Weighter<ScoreRunId, Arc<Summary>> for Weigh {
    fn weight(&self, _: &ScoreRunId, summary: &Arc<Summary>) -> u64 {
        let segments: usize = summary.candidates.iter().map(|one| one.q.len()).sum();
        let of_experts: usize = summary.experts.iter().map(Vec::len).sum();
        let bytes = segments as u64 * 32 + of_experts as u64 * 4 + summary.candidates.len() as u64 * 256;
        // A summary larger than the whole cache is kept alone, because its run could not be shown otherwise.
        bytes.min(RUN_BYTES / 10 * 9)
    }
}

#[cfg(test)]
mod tests;
