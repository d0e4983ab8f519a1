//! Measures of score runs of the same episodes: how they separate, how they agree, how they follow length.
//!
//! Everything is measured on q, the order in which a selection keeps segments, since w lacks the local scale of some
//! scorers. Must not depend on a server.

use gleaner_core::selection::{Candidate, Filter, Rule, best_first};
use gleaner_core::statistics::{Stratified, auroc, auroc_interval, auroc_within, jaccard, spearman};

use super::super::pool::pool_auroc;
use super::super::report::PooledAuroc;
use super::episodes::{Episodes, Known};
use super::report::{Auroc, LengthCorrelation, Separated};
use crate::quality::{ALL, FAILURES, MarkedEpisode, Separation, mean, separations};

/// The group of episodes with an outcome.
const OUTCOME: &str = "success over failure";
// Of the resampling; any constant will do.
const RESAMPLING_SEED: u64 = 0;

/// A score run over the episodes of a comparison.
#[derive(Clone, Debug)]
pub(super) struct Run {
    pub(super) id: String,
    /// In the order of [`Episodes::imperfect`]; unmarked ones have an empty mark.
    pub(super) imperfect: Vec<MarkedEpisode>,
    /// The mean q of each expert, in their order.
    pub(super) experts: Vec<Option<f64>>,
}

impl Run {
    /// q of every imperfect segment.
    pub(super) fn q(&self) -> Vec<f64> {
        self.imperfect.iter().flat_map(|episode| &episode.scores.q).map(|q| f64::from(*q)).collect()
    }

    /// Whether each imperfect segment is in the best part, as the server selects it.
    pub(super) fn best(&self, top: f64) -> Vec<bool> {
        let filter = Filter::new(Rule::TopFraction(top), &best_first(self.segments().collect()));
        self.segments().map(|(q, w)| filter.keeps(w, q)).collect()
    }

    fn segments(&self) -> impl Iterator<Item = (f32, f64)> {
        self.imperfect.iter().flat_map(|episode| episode.scores.q.iter().copied().zip(episode.scores.w.iter().copied()))
    }

    /// The mean q of each imperfect episode.
    fn means(&self) -> Vec<Option<f64>> {
        self.imperfect.iter().map(mean_q).collect()
    }
}

/// The mean q of an episode; `None` without steps.
fn mean_q(episode: &MarkedEpisode) -> Option<f64> {
    mean(&episode.scores.q.iter().map(|q| f64::from(*q)).collect::<Vec<_>>())
}

/// The length of an episode as the score of each of its segments: shorter is better.
#[expect(clippy::cast_precision_loss, reason = "an episode's steps are far below 2^23")]
pub(super) fn by_length(run: &Run) -> Run {
    blind(run, |steps| vec![-(steps as f32); steps])
}

/// The number of the step at which a segment ends as its score: earlier is better.
#[expect(clippy::cast_precision_loss, reason = "an episode's steps are far below 2^23")]
pub(super) fn by_step(run: &Run) -> Run {
    blind(run, |steps| (0..steps).map(|step| -(step as f32)).collect())
}

/// The same episodes with the scores that `q` gives for their number of steps.
fn blind(run: &Run, q: impl Fn(usize) -> Vec<f32>) -> Run {
    let scored = |episode: &MarkedEpisode| {
        let steps = episode.scores.q.len();
        let scores = Candidate { q: q(steps), w: vec![0.0; steps], ..episode.scores.clone() };
        MarkedEpisode { scores, ..episode.clone() }
    };
    Run { id: String::new(), imperfect: run.imperfect.iter().map(scored).collect(), experts: Vec::new() }
}

/// How well runs separate, by marks and by outcomes.
pub(super) fn separated(episodes: &Episodes, runs: &[&Run]) -> Separated {
    let marked: Vec<Vec<Separation>> = runs.iter().map(|run| marked(episodes, run)).collect();
    let outcomes: Vec<Option<(PooledAuroc, Option<Stratified>)>> =
        runs.iter().map(|run| by_outcome(episodes, run)).collect();
    let rows = pool_auroc(marked.iter().map(Vec::as_slice)).into_iter().map(|pooled| {
        let within = runs.iter().filter_map(|run| auroc_within(&strata(episodes, run, &pooled.cohort)));
        let at_step = runs.iter().filter_map(|run| auroc_within(&steps(episodes, run, &pooled.cohort)));
        with_strata(pooled.clone(), within, at_step)
    });
    Separated { marked: rows.collect(), outcome: outcome(outcomes.into_iter().flatten().collect()) }
}

fn marked(episodes: &Episodes, run: &Run) -> Vec<Separation> {
    if episodes.marked == 0 { Vec::new() } else { separations(&run.imperfect[..episodes.marked]) }
}

fn with_strata(
    pooled: PooledAuroc,
    within: impl Iterator<Item = Stratified>,
    at_step: impl Iterator<Item = Stratified>,
) -> Auroc {
    let ((equal_length, pairs), (equal_step, step_pairs)) = (over_runs(within), over_runs(at_step));
    Auroc { pooled, equal_length, pairs, equal_step, step_pairs }
}

/// The mean over runs, and the number of pairs, which is that of each.
fn over_runs(within: impl Iterator<Item = Stratified>) -> (Option<f64>, u64) {
    let found: Vec<Stratified> = within.collect();
    let centre = mean(&found.iter().map(|stratified| stratified.auroc).collect::<Vec<_>>());
    (centre, found.first().map_or(0, |stratified| stratified.pairs))
}

/// The marked episodes of a group of [`separations`], with their places.
fn of_group<'a>(episodes: &Episodes, run: &'a Run, group: &str) -> impl Iterator<Item = (usize, &'a MarkedEpisode)> {
    let belongs = move |episode: &MarkedEpisode| match group {
        ALL => true,
        FAILURES => !episode.success,
        cohort => episode.scores.cohort == cohort,
    };
    run.imperfect[..episodes.marked].iter().enumerate().filter(move |(_, episode)| belongs(episode))
}

/// The marked segments of a group in the strata of equal length.
fn strata(episodes: &Episodes, run: &Run, group: &str) -> Vec<Vec<(f64, bool)>> {
    let steps = of_group(episodes, run, group);
    episodes.in_strata(steps.flat_map(|(place, episode)| episode.steps().map(move |step| (place, step))))
}

/// The marked segments of a group by the step at which they end.
fn steps(episodes: &Episodes, run: &Run, group: &str) -> Vec<Vec<(f64, bool)>> {
    let mut strata = Vec::new();
    for (at, step) in of_group(episodes, run, group).flat_map(|(_, episode)| episode.steps().enumerate()) {
        if strata.len() <= at {
            strata.resize_with(at + 1, Vec::new);
        }
        strata[at].push(step);
    }
    strata
}

/// Mean q of episodes that succeeded against those that failed.
fn by_outcome(episodes: &Episodes, run: &Run) -> Option<(PooledAuroc, Option<Stratified>)> {
    let judged = |(place, (episode, mean)): (usize, (&Known, Option<f64>))| {
        (episode.succeeded() || episode.outcome == "failure").then_some((place, (mean?, episode.succeeded())))
    };
    let means: Vec<(usize, (f64, bool))> =
        episodes.imperfect.iter().zip(run.means()).enumerate().filter_map(judged).collect();
    let scored: Vec<(f64, bool)> = means.iter().map(|(_, scored)| *scored).collect();
    let each: Vec<Vec<(f64, bool)>> = scored.iter().map(|scored| vec![*scored]).collect();
    let interval = auroc_interval(&each, RESAMPLING_SEED);
    let pooled = PooledAuroc { cohort: OUTCOME.to_owned(), mean: auroc(&scored)?, interval };
    Some((pooled, auroc_within(&episodes.in_strata(means))))
}

fn outcome(found: Vec<(PooledAuroc, Option<Stratified>)>) -> Option<Auroc> {
    let centre = mean(&found.iter().map(|(pooled, _)| pooled.mean).collect::<Vec<_>>())?;
    let bounds = found.iter().filter_map(|(pooled, _)| pooled.interval);
    let interval = bounds.reduce(|(low, high), (lower, higher)| (low.min(lower), high.max(higher)));
    let pooled = PooledAuroc { cohort: OUTCOME.to_owned(), mean: centre, interval };
    Some(with_strata(pooled, found.into_iter().filter_map(|(_, within)| within), std::iter::empty()))
}

/// The correlation of mean q with length, over the imperfect episodes, over those of each outcome if there are several,
/// and over the experts.
pub(super) fn length(episodes: &Episodes, runs: &[&Run]) -> Vec<LengthCorrelation> {
    let mut outcomes: Vec<&str> = episodes.imperfect.iter().map(|episode| episode.outcome.as_str()).collect();
    outcomes.sort_unstable();
    outcomes.dedup();
    let imperfect = |group: &str, outcome: Option<&str>| {
        let of = |known: &&Known| outcome.is_none_or(|outcome| known.outcome == outcome);
        let count = episodes.imperfect.iter().filter(of).count();
        let values = |run: &&Run| {
            let all = episodes.imperfect.iter().zip(run.means());
            correlation(all.filter(|(known, _)| of(known)))
        };
        correlated(group, count, runs.iter().filter_map(values).collect())
    };
    let mut groups = vec![imperfect("imperfect", None)];
    if outcomes.len() > 1 {
        let named = |outcome: &&str| imperfect(&format!("imperfect, {outcome}"), Some(*outcome));
        groups.extend(outcomes.iter().map(named));
    }
    let values = |run: &&Run| correlation(episodes.experts.iter().zip(run.experts.iter().copied()));
    groups.push(correlated("experts", episodes.experts.len(), runs.iter().filter_map(values).collect()));
    groups
}

fn correlated(group: &str, episodes: usize, found: Vec<f64>) -> LengthCorrelation {
    LengthCorrelation { group: group.to_owned(), episodes, spearman: mean(&found) }
}

#[expect(clippy::cast_precision_loss, reason = "an episode's steps are far below 2^52")]
fn correlation<'a>(episodes: impl Iterator<Item = (&'a Known, Option<f64>)>) -> Option<f64> {
    let pairs = episodes.filter_map(|(known, mean)| Some((known.steps as f64, mean?)));
    let (lengths, means): (Vec<f64>, Vec<f64>) = pairs.unzip();
    spearman(&lengths, &means)
}

/// What the agreement of two runs depends on.
pub(super) struct Ranking<'a> {
    id: &'a str,
    q: Vec<f64>,
    best: Vec<bool>,
}

impl<'a> Ranking<'a> {
    pub(super) fn new(run: &'a Run, top: f64) -> Self {
        Self { id: &run.id, q: run.q(), best: run.best(top) }
    }
}

/// Two scorers, seed by seed: the mean correlation of q and the mean overlap of the best parts. Equal pairs of runs count
/// once.
pub(super) fn agreement(one: &[Option<&Ranking>], other: &[Option<&Ranking>]) -> (Option<f64>, Option<f64>) {
    let mut pairs: Vec<(&Ranking, &Ranking)> = Vec::new();
    for pair in one.iter().zip(other).filter_map(|(one, other)| Some(((*one)?, (*other)?))) {
        if pairs.iter().all(|known| (known.0.id, known.1.id) != (pair.0.id, pair.1.id)) {
            pairs.push(pair);
        }
    }
    let correlations: Vec<f64> = pairs.iter().filter_map(|(one, other)| spearman(&one.q, &other.q)).collect();
    let overlaps: Vec<f64> = pairs.iter().filter_map(|(one, other)| jaccard(&one.best, &other.best)).collect();
    (mean(&correlations), mean(&overlaps))
}

/// The mean correlation of q between two of a scorer's runs, which are all different; `None` of one run.
pub(super) fn stability(runs: &[&Ranking]) -> Option<f64> {
    let pairs = runs.iter().enumerate().flat_map(|(at, one)| runs[at + 1..].iter().map(move |other| (one, other)));
    mean(&pairs.filter_map(|(one, other)| spearman(&one.q, &other.q)).collect::<Vec<_>>())
}

#[cfg(test)]
mod tests;
