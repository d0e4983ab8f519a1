//! The progress of the matches of later steps: how far, or how fast, an episode gets ahead after a segment. Plain numbers;
//! the measure joins them with similarity.
//!
//! p_t is the share of its expert's episode at which the match of step t ends. After the end of an episode p rises as that
//! of a mean expert does, so that what was not recorded counts neither for nor against its last segments.

use std::collections::VecDeque;

use gleaner_core::NormaliserKind;

use super::{EpisodeScores, Normaliser};

gleaner_core::words! {
    /// How the progress of later matches counts.
    pub enum ProgressForm {
        /// The highest pace at which matches get ahead over any stretch from two fifths of the lookahead to all of it,
        /// relative to that of the median expert segment, at most 1. A good segment counts as good although a fault follows
        /// soon, and segments of a slow operator count less only by as much as they are slower.
        Pace = "pace",
        /// How far the furthest match within the lookahead is ahead, as the share of expert segments that get at most as far.
        /// Precise where imperfect episodes are as fast as experts; segments within the lookahead before a fault, and those of
        /// a slower operator, count as bad.
        Furthest = "furthest",
    }
}

/// Stretches over which a pace is measured, of even steps in length.
const STRETCHES: usize = 8;
/// The shortest of them, as a part of the longest: over shorter ones a match that is off by a few steps looks like haste.
const SHORTEST: f64 = 0.4;

/// The progress of matches.
pub(super) struct Progress {
    form: ProgressForm,
    /// Δ in steps, at least 1.
    pub(super) delta: usize,
    /// The rise of p at each step of a mean expert.
    rise: f64,
    /// The steps of every expert, in the given order.
    pub(super) lengths: Vec<usize>,
}

/// What the progress of a segment is worth, from 0 to 1.
pub(super) enum Worth {
    /// The share of expert segments whose progress is at most as large.
    Share(Normaliser),
    /// The ratio to this progress, that of the median expert segment, at most 1.
    Ratio(f64),
}

impl Progress {
    /// The progress within `delta` steps, for experts of these lengths and their mean.
    pub(super) fn new(form: ProgressForm, delta: usize, (lengths, mean): (Vec<usize>, f64)) -> Self {
        Self { form, delta, rise: 1.0 / mean, lengths }
    }

    /// The worth of progress, by the scores of all experts.
    pub(super) fn worth(&self, experts: &[EpisodeScores]) -> Worth {
        let mut all: Vec<f64> = experts.iter().flat_map(|episode| self.of(episode)).collect();
        match self.form {
            ProgressForm::Furthest => Worth::Share(Normaliser::fit(NormaliserKind::Calibrated, all)),
            ProgressForm::Pace => {
                let middle = all.len() / 2;
                let median = all.get(middle).is_some().then(|| *all.select_nth_unstable_by(middle, f64::total_cmp).1);
                Worth::Ratio(median.unwrap_or_default())
            }
        }
    }

    /// The progress of every segment of an episode.
    pub(super) fn of(&self, episode: &EpisodeScores) -> Vec<f64> {
        let matches = episode.match_episode.iter().zip(&episode.match_step);
        #[expect(clippy::cast_precision_loss, reason = "an episode has far fewer steps than 2^52")]
        let share = |(expert, step): (&u32, &u32)| f64::from(step + 1) / self.lengths[*expert as usize] as f64;
        let shares: Vec<f64> = matches.map(share).collect();
        match self.form {
            ProgressForm::Pace => paces(&shares, self.delta, self.rise),
            ProgressForm::Furthest => gains(&shares, self.delta, self.rise),
        }
    }
}

impl Worth {
    /// The worth of this progress.
    pub(super) fn of(&self, progress: f64) -> f64 {
        match self {
            Self::Share(shares) => shares.q(progress).into(),
            // Experts whose matches do not advance tell nothing of progress.
            Self::Ratio(median) if *median <= 0.0 => 1.0,
            Self::Ratio(median) => (progress / median).clamp(0.0, 1.0),
        }
    }
}

/// For each of `progress`, which rises by `rise` a step after the end, the highest mean rise a step over the stretches
/// within `delta`.
#[expect(clippy::cast_precision_loss, reason = "an episode has far fewer steps than 2^52")]
fn paces(progress: &[f64], delta: usize, rise: f64) -> Vec<f64> {
    let Some(last) = progress.last() else { return Vec::new() };
    let stretches = stretches(delta);
    let ahead = |at: usize, steps: usize| match progress.get(at + steps) {
        Some(later) => *later,
        None => last + rise * (at + steps + 1 - progress.len()) as f64,
    };
    let pace = |at: usize, steps: &usize| (ahead(at, *steps) - progress[at]) / *steps as f64;
    let highest = |at| stretches.iter().map(|steps| pace(at, steps)).fold(f64::NEG_INFINITY, f64::max);
    (0..progress.len()).map(highest).collect()
}

/// The lengths of the stretches within `delta` steps.
#[expect(clippy::cast_precision_loss, reason = "an episode has far fewer steps than 2^52")]
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "at most `delta`")]
fn stretches(delta: usize) -> Vec<usize> {
    let longest = delta as f64;
    let shortest = (longest * SHORTEST).max(1.0);
    let part = |number: usize| number as f64 / (STRETCHES - 1) as f64;
    let length = |number| (shortest + (longest - shortest) * part(number)).round() as usize;
    let mut lengths: Vec<usize> = (0..STRETCHES).map(length).collect();
    lengths.dedup();
    lengths
}

/// The largest of the next `delta` values less the present one, for each of `progress`, which rises by `rise` a step after
/// the end.
fn gains(progress: &[f64], delta: usize, rise: f64) -> Vec<f64> {
    let Some(last) = progress.last() else { return Vec::new() };
    let gain = |(at, recorded): (usize, Option<f64>)| {
        let beyond = (at + delta).checked_sub(progress.len() - 1).filter(|steps| *steps > 0);
        #[expect(clippy::cast_precision_loss, reason = "an episode has far fewer steps than 2^52")]
        let beyond = beyond.map(|steps| last + rise * steps as f64);
        recorded.into_iter().chain(beyond).fold(f64::NEG_INFINITY, f64::max) - progress[at]
    };
    largest_ahead(progress, delta).into_iter().enumerate().map(gain).collect()
}

/// The largest of the next `delta` values of each; `None` where there is no next one, or `delta` is 0.
pub(super) fn largest_ahead(values: &[f64], delta: usize) -> Vec<Option<f64>> {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gain_is_the_most_within_reach_and_rises_at_an_expert_s_pace_after_the_end() {
        let progress = [0.1, 0.5, 0.2, 0.2, 0.8, 0.7];
        let rise = 0.125;
        let later: Vec<f64> = (1u8..9).map(|step| 0.7 + rise * f64::from(step)).collect();
        let all = [&progress[..], &later].concat();
        let plain = |delta: usize| -> Vec<f64> {
            let reach = |at: usize| all[at + 1..].iter().take(delta).copied().fold(f64::NEG_INFINITY, f64::max);
            (0..progress.len()).map(|at| reach(at) - progress[at]).collect()
        };
        for delta in 1..8 {
            assert_eq!(gains(&progress, delta, rise), plain(delta), "{delta}");
        }
        assert_eq!(gains(&progress, 1, rise)[1], 0.2 - 0.5, "a gain may be negative");
        assert_eq!(gains(&[], 3, rise), Vec::<f64>::new());
    }

    #[test]
    fn stretches_are_even_from_two_fifths_to_all_of_the_lookahead() {
        assert_eq!(stretches(10), [4, 5, 6, 7, 8, 9, 10]);
        assert_eq!(stretches(70), [28, 34, 40, 46, 52, 58, 64, 70]);
        assert_eq!([stretches(1), stretches(2)], [vec![1], vec![1, 2]]);
    }

    #[test]
    fn a_pace_is_the_highest_over_a_stretch_and_an_expert_s_own_after_the_end() {
        // Ten steps at 0.1 a step, then a halt.
        let halted: Vec<f64> = (0u8..40).map(|step| 0.1 * f64::from(step.min(10))).collect();
        let pace = paces(&halted, 10, 0.1);
        let near = |pace: f64, wanted: f64| (pace - wanted).abs() < 1e-9;
        assert!(pace[..=6].iter().all(|pace| near(*pace, 0.1)), "a halt four steps ahead does not count");
        assert!(near(pace[7], 0.3 / 4.0) && near(pace[9], 0.1 / 4.0), "and nearer ones count little by little");
        assert!(pace[10..30].iter().all(|pace| *pace == 0.0));
        assert!(pace[39] > 0.099, "what was not recorded does not count against the last step: {}", pace[39]);
        let back = paces(&[0.75, 0.25], 1, 0.125);
        assert_eq!(back, [-0.5, 0.125], "a pace may be negative");
        assert_eq!(paces(&[], 3, 0.1), Vec::<f64>::new());
    }

    #[test]
    fn worth_is_a_ratio_to_the_median_expert_or_a_share_of_the_experts() {
        let ratio = Worth::Ratio(0.2);
        assert_eq!([-0.1, 0.0, 0.1, 0.2, 0.9].map(|pace| ratio.of(pace)), [0.0, 0.0, 0.5, 1.0, 1.0]);
        assert_eq!([-0.1, 0.1].map(|pace| Worth::Ratio(0.0).of(pace)), [1.0, 1.0]);
        let share = Worth::Share(Normaliser::fit(NormaliserKind::Calibrated, vec![0.1, 0.2, 0.3]));
        assert_eq!([0.0, 0.2, 0.3].map(|gain| share.of(gain)), [0.0, 0.5, 1.0]);
    }
}
