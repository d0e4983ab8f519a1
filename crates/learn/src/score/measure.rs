//! The measure of a segment, which the normaliser turns into q: its similarity w alone, or together with the progress of the
//! matches of later steps. Independent of norm and of how matches are found.
//!
//! A segment may be like an expert's and lead nowhere: a robot that stands still, a carry to a wrong goal. The matches of
//! later steps then do not advance. With p_t the share of its expert's episode at which the match of step t ends, the
//! progress of a segment is g_t = max over 1 ≤ k ≤ Δ of p_{t+k} − p_t, where Δ is a share of a mean expert episode. After
//! the end of the episode p rises as that of a mean expert does, so that what was not recorded counts neither for nor
//! against its last segments. With F the share of expert segments, each compared with the other experts, whose value
//! is at most as large, the measure is (F(w) + F(g)) / 2 · min(1, F(w) / 0.05): no progress makes up for a segment that is
//! farther from the experts than nearly all of their own.

use std::collections::VecDeque;

use super::{EpisodeScores, Normaliser, local};
use crate::trajectory::Trajectory;
use gleaner_core::NormaliserKind;

/// Share of expert segments. A segment that is farther from other experts than all but these is an outlier.
const OUTLIERS: f64 = 0.05;

/// The measure of a run's segments.
pub(super) struct Measure {
    /// Per expert, in the given order, and step, the local scale; `None` if similarities are not scaled.
    local: Option<Vec<Vec<f64>>>,
    outlook: Option<Outlook>,
}

/// The scales of similarity and of progress, and that of both together.
struct Outlook {
    near: Normaliser,
    ahead: Normaliser,
    both: Normaliser,
    progress: Progress,
}

/// The progress of matches.
struct Progress {
    /// Δ in steps, at least 1.
    delta: usize,
    /// The rise of p at each step of a mean expert.
    pace: f64,
    /// The steps of every expert, in the given order.
    lengths: Vec<usize>,
}

impl Measure {
    /// The measure by the scores of all experts, each against the others. `lookahead` is Δ as a share of a mean episode of
    /// `experts`, to which matches refer. Without scores, as of a single expert, or with a share of 0, it is w alone.
    pub(super) fn new(
        local: Option<Vec<Vec<f64>>>,
        (experts, lookahead): (&[Trajectory], f64),
        scores: &[EpisodeScores],
    ) -> Self {
        let alone = Self { local, outlook: None };
        if scores.is_empty() || lookahead <= 0.0 {
            return alone;
        }
        let lengths: Vec<usize> = experts.iter().map(Trajectory::steps).collect();
        #[expect(clippy::cast_precision_loss, reason = "far fewer steps than 2^52")]
        let mean = lengths.iter().sum::<usize>() as f64 / lengths.len().max(1) as f64;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a part of an episode's steps")]
        let delta = ((lookahead * mean).round() as usize).max(1);
        let progress = Progress { delta, pace: 1.0 / mean, lengths };
        let share = |values: Vec<f64>| Normaliser::fit(NormaliserKind::Calibrated, values);
        let near = share(scores.iter().flat_map(|episode| alone.relative(episode)).collect());
        let ahead = share(scores.iter().flat_map(|episode| progress.gains(episode)).collect());
        let mut outlook = Outlook { near, ahead, both: share(Vec::new()), progress };
        outlook.both = share(scores.iter().flat_map(|episode| outlook.of(alone.relative(episode), episode)).collect());
        Self { outlook: Some(outlook), ..alone }
    }

    /// The measure of every segment of an episode, by the places of its matches.
    pub(super) fn of(&self, episode: &EpisodeScores) -> Vec<f64> {
        let relative = self.relative(episode);
        match &self.outlook {
            Some(outlook) => outlook.of(relative, episode),
            None => relative.collect(),
        }
    }

    /// The measure of a segment whose later steps are unknown: the one that is as good among experts as its similarity is.
    pub(super) fn now(&self, w: f64, (expert, step): (usize, usize)) -> f64 {
        let relative = self.local.as_ref().map_or(w, |local| w / local[expert][step]);
        self.outlook.as_ref().map_or(relative, |outlook| match outlook.near.q(relative) {
            0.0 => 0.0, // farther than every expert, as in `blend`
            near => outlook.both.at_share(near),
        })
    }

    fn relative<'a>(&'a self, episode: &'a EpisodeScores) -> impl Iterator<Item = f64> + 'a {
        local::relative(self.local.as_ref(), episode)
    }
}

impl Outlook {
    /// The measure of every segment of an episode by its similarities, relative to the local scale, and its matches.
    fn of(&self, relative: impl Iterator<Item = f64>, episode: &EpisodeScores) -> Vec<f64> {
        let both = relative.zip(self.progress.gains(episode));
        both.map(|(w, gain)| blend(self.near.q(w).into(), self.ahead.q(gain).into())).collect()
    }
}

impl Progress {
    /// g of every segment of an episode.
    fn gains(&self, episode: &EpisodeScores) -> Vec<f64> {
        let matches = episode.match_episode.iter().zip(&episode.match_step);
        #[expect(clippy::cast_precision_loss, reason = "an episode has far fewer steps than 2^52")]
        let share = |(expert, step): (&u32, &u32)| f64::from(step + 1) / self.lengths[*expert as usize] as f64;
        gains(&matches.map(share).collect::<Vec<_>>(), self.delta, self.pace)
    }
}

/// The largest of the next `delta` values less the present one, for each of `progress`, which rises by `pace` after the
/// end.
fn gains(progress: &[f64], delta: usize, pace: f64) -> Vec<f64> {
    let Some(last) = progress.last() else { return Vec::new() };
    let mut gains = vec![0.0; progress.len()];
    // Later values within reach, nearest last, each larger than all nearer ones, so that the first is the largest.
    let mut best: VecDeque<(usize, f64)> = VecDeque::new();
    for at in (0..progress.len()).rev() {
        while best.front().is_some_and(|(place, _)| *place > at + delta) {
            best.pop_front();
        }
        let recorded = best.front().map(|(_, most)| *most);
        let beyond = (at + delta).checked_sub(progress.len() - 1).filter(|steps| *steps > 0);
        #[expect(clippy::cast_precision_loss, reason = "an episode has far fewer steps than 2^52")]
        let beyond = beyond.map(|steps| last + pace * steps as f64);
        gains[at] = recorded.into_iter().chain(beyond).fold(f64::NEG_INFINITY, f64::max) - progress[at];
        while best.back().is_some_and(|(_, value)| *value <= progress[at]) {
            best.pop_back();
        }
        best.push_back((at, progress[at]));
    }
    gains
}

/// The measure by the shares of experts that are at most as near, and that gain at most as much.
fn blend(near: f64, ahead: f64) -> f64 {
    f64::midpoint(near, ahead) * (near / OUTLIERS).min(1.0)
}

#[cfg(test)]
mod tests;
