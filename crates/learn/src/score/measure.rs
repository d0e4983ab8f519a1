//! The measure of a segment, which the normaliser turns into q: its similarity w alone, or together with the progress of the
//! matches of later steps. Independent of norm and of how matches are found.
//!
//! A segment may be like an expert's and lead nowhere: a robot that stands still, a carry to a wrong goal. The matches of
//! later steps then do not advance. With p_t the share of its expert's episode at which the match of step t ends, the
//! pace of a segment is v_t = max over stretches k of (p_{t+k} − p_t) / k, each between 0.4 Δ and Δ, where Δ is a share of a
//! mean expert episode, and its worth v = min(1, v_t / the median one of expert segments). With F(w) the share of expert
//! segments, each compared with the other experts, that are at most as near, the measure is
//! (F(w) + v) / 2 · min(1, F(w) / 0.05): no progress makes up for a segment that is farther from the experts than nearly all
//! of their own. In the older form `furthest` the worth is F(g), of g_t = max over 1 ≤ k ≤ Δ of p_{t+k} − p_t.
//!
//! A segment may also be unlike the experts' and lead to what they do, as the way back after a bad beginning does. With a
//! lead-in of L steps the measure of step t is the largest of those of the steps t to t + L, of experts too.
//!
//! Most failures are good until a fault and bad after it. With an earliness e the measure of the segment at step t of T is
//! (1 − e) times the measure so far and e times 1 − t / T, of experts too.

use super::ahead::Ahead;
use super::progress::{Progress, Worth, largest_ahead};
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
    /// Progress and its worth; `None` if it does not count.
    ahead: Option<(Progress, Worth)>,
    /// L, the steps within which a segment is as good as the best one that it leads to.
    lead_in: usize,
    /// e, the weight of how early a segment lies.
    earliness: f64,
    /// The scale of all of it together.
    both: Normaliser,
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
        let (lead_in, earliness) = (steps(ahead.lead_in).unwrap_or(0), ahead.earliness);
        let ahead = steps(ahead.lookahead).map(|delta| {
            let progress = Progress::new(ahead.progress, delta, (lengths, mean));
            let worth = progress.worth(scores);
            (progress, worth)
        });
        let mut outlook = Outlook { near, ahead, lead_in, earliness, both: share(Vec::new()) };
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
            Some((progress, worth)) => {
                let both = relative.zip(progress.of(episode));
                both.map(|(w, progress)| blend(self.near.q(w).into(), worth.of(progress))).collect()
            }
            // Similarities have no scale to be joined with a place.
            None if self.earliness > 0.0 => relative.map(|w| self.near.q(w).into()).collect(),
            None => relative.collect(),
        };
        let led = largest_ahead(&own, self.lead_in);
        let led: Vec<f64> = own.into_iter().zip(led).map(|(own, led)| led.map_or(own, |led| own.max(led))).collect();
        if self.earliness == 0.0 {
            return led;
        }
        #[expect(clippy::cast_precision_loss, reason = "an episode has far fewer steps than 2^52")]
        let early = |at: usize| 1.0 - at as f64 / led.len() as f64;
        led.iter().enumerate().map(|(at, own)| (1.0 - self.earliness) * own + self.earliness * early(at)).collect()
    }

    /// The measure of a segment with this similarity whose later steps are unknown.
    fn now(&self, relative: f64) -> f64 {
        match self.near.q(relative) {
            // Farther than every expert, as in `blend`.
            0.0 if self.ahead.is_some() || self.earliness > 0.0 => 0.0,
            0.0 => relative,
            near => self.both.at_share(near),
        }
    }
}

/// The measure by the share of experts that are at most as near, and the worth of the progress.
fn blend(near: f64, ahead: f64) -> f64 {
    f64::midpoint(near, ahead) * (near / OUTLIERS).min(1.0)
}

#[cfg(test)]
mod tests;
