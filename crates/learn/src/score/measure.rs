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
//!
//! A segment may also be unlike the experts' and lead to what they do, as the way back after a bad beginning does. With a
//! lead-in of L steps the measure of step t is the largest of those of the steps t to t + L, of experts too.

use std::collections::VecDeque;

use super::ahead::Ahead;
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

/// What later steps contribute.
struct Outlook {
    /// The scale of similarity.
    near: Normaliser,
    /// Progress and its scale; `None` if it does not count.
    ahead: Option<(Progress, Normaliser)>,
    /// L, the steps within which a segment is as good as the best one that it leads to.
    lead_in: usize,
    /// The scale of all of it together.
    both: Normaliser,
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
    /// The measure by the scores of all experts, each against the others; matches refer to `experts`. Without scores, as of a
    /// single expert, or if no later step counts, it is w alone.
    pub(super) fn new(
        local: Option<Vec<Vec<f64>>>,
        (experts, ahead): (&[Trajectory], Ahead),
        scores: &[EpisodeScores],
    ) -> Self {
        let alone = Self { local, outlook: None };
        if scores.is_empty() || !ahead.counts() {
            return alone;
        }
        let lengths: Vec<usize> = experts.iter().map(Trajectory::steps).collect();
        #[expect(clippy::cast_precision_loss, reason = "far fewer steps than 2^52")]
        let mean = lengths.iter().sum::<usize>() as f64 / lengths.len().max(1) as f64;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a part of an episode's steps")]
        let steps = |share: f64| (share > 0.0).then(|| ((share * mean).round() as usize).max(1));
        let share = |values: Vec<f64>| Normaliser::fit(NormaliserKind::Calibrated, values);
        let near = share(scores.iter().flat_map(|episode| alone.relative(episode)).collect());
        let lead_in = steps(ahead.lead_in).unwrap_or(0);
        let ahead = steps(ahead.lookahead).map(|delta| {
            let progress = Progress { delta, pace: 1.0 / mean, lengths };
            let gains = share(scores.iter().flat_map(|episode| progress.gains(episode)).collect());
            (progress, gains)
        });
        let mut outlook = Outlook { near, ahead, lead_in, both: share(Vec::new()) };
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
        self.outlook.as_ref().map_or(relative, |outlook| outlook.now(relative))
    }

    fn relative<'a>(&'a self, episode: &'a EpisodeScores) -> impl Iterator<Item = f64> + 'a {
        local::relative(self.local.as_ref(), episode)
    }
}

impl Outlook {
    /// The measure of every segment of an episode by its similarities, relative to the local scale, and its matches.
    fn of(&self, relative: impl Iterator<Item = f64>, episode: &EpisodeScores) -> Vec<f64> {
        let own: Vec<f64> = match &self.ahead {
            Some((progress, ahead)) => {
                let both = relative.zip(progress.gains(episode));
                both.map(|(w, gain)| blend(self.near.q(w).into(), ahead.q(gain).into())).collect()
            }
            None => relative.collect(),
        };
        let led = largest_ahead(&own, self.lead_in);
        own.into_iter().zip(led).map(|(own, led)| led.map_or(own, |led| own.max(led))).collect()
    }

    /// The measure of a segment with this similarity whose later steps are unknown.
    fn now(&self, relative: f64) -> f64 {
        match self.near.q(relative) {
            // Farther than every expert, as in `blend`.
            0.0 if self.ahead.is_some() => 0.0,
            0.0 => relative,
            near => self.both.at_share(near),
        }
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
    let gain = |(at, recorded): (usize, Option<f64>)| {
        let beyond = (at + delta).checked_sub(progress.len() - 1).filter(|steps| *steps > 0);
        #[expect(clippy::cast_precision_loss, reason = "an episode has far fewer steps than 2^52")]
        let beyond = beyond.map(|steps| last + pace * steps as f64);
        recorded.into_iter().chain(beyond).fold(f64::NEG_INFINITY, f64::max) - progress[at]
    };
    largest_ahead(progress, delta).into_iter().enumerate().map(gain).collect()
}

/// The largest of the next `delta` values of each; `None` where there is no next one, or `delta` is 0.
fn largest_ahead(values: &[f64], delta: usize) -> Vec<Option<f64>> {
    let mut largest = vec![None; values.len()];
    // Later values within reach, nearest last, each larger than all nearer ones, so that the first is the largest.
    let mut best: VecDeque<(usize, f64)> = VecDeque::new();
    for at in (0..values.len()).rev() {
        while best.front().is_some_and(|(place, _)| *place > at + delta) {
            best.pop_front();
        }
        largest[at] = best.front().map(|(_, most)| *most);
        while best.back().is_some_and(|(_, value)| *value <= values[at]) {
            best.pop_back();
        }
        best.push_back((at, values[at]));
    }
    largest
}

/// The measure by the shares of experts that are at most as near, and that gain at most as much.
fn blend(near: f64, ahead: f64) -> f64 {
    f64::midpoint(near, ahead) * (near / OUTLIERS).min(1.0)
}

#[cfg(test)]
mod tests;
