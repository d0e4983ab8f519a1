//! The scorer `blend`: the mean of two calibrated qualities, that of `raw` and that of `progress`. Each finds what the other
//! misses: `progress` a segment that is like an expert's and does not bring the task forward (a frozen robot, a wrong
//! goal), and `raw` one that is unlike an expert's and seems to (an open gripper).
//!
//! With q_r and q_p the share of expert segments whose similarity, or whose gain, is at most as large,
//! w = (q_r + q_p) / 2 · min(1, q_r / 0.05): no progress makes up for a segment that is farther from the experts than nearly
//! all of their own. The matches are those of `raw`.

use gleaner_core::Group as _;
use gleaner_core::NormaliserKind;
use gleaner_core::kinds::Needs;

use super::progress::{self, ProgressSpec};
use super::raw::{self, RawSpec};
use super::{Scorer, ScorerKind, SeedSpec};
use crate::score::comparison::NearestSpec;
use crate::score::local;
use crate::score::run::Found;
use crate::score::{EpisodeScores, Normaliser};
use crate::train::Monitor;

/// Share of expert segments. A segment that is farther from other experts than all but these is an outlier.
const OUTLIERS: f64 = 0.05;

pub(super) const KIND: ScorerKind = ScorerKind {
    name: "blend",
    title: "Raw and progress",
    about: "The mean of two shares of expert segments: of those at least as far from other experts, as `raw` compares \
            them, and of those that make at most as much progress, as `progress` estimates it; less for outliers.",
    needs: Needs { encoder: true, history: false, images: true, all_episodes: true },
    settings: || [SeedSpec::schema(), RawSpec::schema(), NearestSpec::schema(), ProgressSpec::schema()].concat(),
    open: |chosen| Ok(Scorer::Blend(raw::comparison(chosen)?, progress::trained(chosen)?)),
};

/// The quality of a segment by both shares.
fn blend(near: f64, gained: f64) -> f64 {
    f64::midpoint(near, gained) * (near / OUTLIERS).min(1.0)
}

/// The blend of the calibrated qualities of both, with the matches of the first.
pub(in crate::score) fn mean(
    mut nearest: Found,
    (imperfect, experts): (Vec<EpisodeScores>, Vec<EpisodeScores>),
) -> Found {
    let local = nearest.local.take();
    let near = calibrated(&nearest.experts, |episode| local::relative(local.as_ref(), episode).collect());
    let gained = calibrated(&experts, |episode| episode.w.clone());
    let mix = |ours: &mut [EpisodeScores], theirs: &[EpisodeScores]| {
        for (ours, theirs) in ours.iter_mut().zip(theirs) {
            let relative: Vec<f64> = local::relative(local.as_ref(), ours).collect();
            let both = relative.into_iter().zip(&theirs.w);
            ours.w = both.map(|(w, gain)| blend(near.q(w).into(), gained.q(*gain).into())).collect();
        }
    };
    mix(&mut nearest.imperfect, &imperfect);
    mix(&mut nearest.experts, &experts);
    nearest
}

/// The calibration by the experts' values.
fn calibrated(experts: &[EpisodeScores], values: impl FnMut(&EpisodeScores) -> Vec<f64>) -> Normaliser {
    Normaliser::fit(NormaliserKind::Calibrated, experts.iter().flat_map(values).collect())
}

/// A monitor of one half of the work: of the first half of all units, or of the second.
pub(in crate::score) struct Half<'a> {
    pub(in crate::score) monitor: &'a mut dyn Monitor,
    pub(in crate::score) is_second: bool,
}

impl Monitor for Half<'_> {
    fn progress(&mut self, step: u64, total: u64, metrics: &[(&'static str, f64)]) {
        let before = if self.is_second { total } else { 0 };
        self.monitor.progress(before + step, 2 * total, metrics);
    }

    fn checkpoint(&mut self, step: u64, bytes: &[u8]) -> Result<(), String> {
        self.monitor.checkpoint(step, bytes)
    }

    fn cancelled(&self) -> bool {
        self.monitor.cancelled()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::LearnError;
    use crate::score::Scores;
    use crate::score::tests::{score_anew, spec_of};
    use crate::toy;
    use crate::train::Silent;
    use crate::trajectory::Trajectory;

    fn run(scorer: &str, normaliser: NormaliserKind) -> Result<Scores, LearnError> {
        let (experts, steps) = (toy::experts(5, 12), ("progress_steps", 8.into()));
        let imperfect = [toy::episode("a", 70, 9, false), Trajectory { id: "b".into(), ..experts[1].clone() }];
        let changed = if scorer == "raw" { Vec::new() } else { vec![steps] };
        let spec = gleaner_core::ScoreSpec { normaliser, ..spec_of(scorer, &changed) };
        score_anew(&experts, &imperfect, &spec, &mut Silent)
    }

    #[test]
    fn progress_does_not_make_up_for_an_outlier() {
        assert_eq!([blend(0.05, 1.0), blend(0.5, 0.5), blend(1.0, 0.0)], [0.525, 0.5, 0.5]);
        assert_eq!([blend(0.0, 1.0), blend(0.025, 0.975)], [0.0, 0.25]);
    }

    #[test]
    fn w_is_the_blend_of_both_qualities_and_matches_are_those_of_raw() {
        let calibrated = NormaliserKind::Calibrated;
        let [blend, raw, progress] = ["blend", "raw", "progress"].map(|name| run(name, calibrated).unwrap());
        let episodes = |scores: &Scores| scores.imperfect.iter().chain(&scores.experts).cloned().collect::<Vec<_>>();
        for ((blend, raw), progress) in episodes(&blend).iter().zip(episodes(&raw)).zip(episodes(&progress)) {
            let both = raw.q.iter().zip(&progress.q);
            let expected: Vec<f64> =
                both.map(|(near, gained)| super::blend((*near).into(), (*gained).into())).collect();
            assert_eq!(blend.w, expected, "{}", blend.episode_id);
            assert_eq!((&blend.match_episode, &blend.match_step), (&raw.match_episode, &raw.match_step));
        }
        let experts: Vec<f32> = blend.experts.iter().flat_map(|expert| expert.q.clone()).collect();
        let above = experts.iter().filter(|q| **q > 0.5).count();
        assert!((experts.len() / 2).abs_diff(above) <= 3, "half of the experts' q are above a half: {above}");
    }

    #[test]
    fn other_normalisers_apply_to_the_blend() {
        let scores = run("blend", NormaliserKind::MinMax).unwrap();
        let all: Vec<f64> = scores.imperfect.iter().flat_map(|episode| episode.w.clone()).collect();
        let highest = all.iter().copied().fold(0.0, f64::max);
        assert_eq!(scores.normaliser.hi, highest);
        assert!(scores.imperfect.iter().any(|episode| episode.q.contains(&1.0)));
    }

    #[test]
    fn progress_of_both_halves_never_falls() {
        struct Seen(Vec<(u64, u64)>);
        impl Monitor for Seen {
            fn progress(&mut self, step: u64, total: u64, _: &[(&'static str, f64)]) {
                self.0.push((step, total));
            }

            fn checkpoint(&mut self, _: u64, _: &[u8]) -> Result<(), String> {
                Ok(())
            }

            fn cancelled(&self) -> bool {
                false
            }
        }
        let experts = toy::experts(4, 8);
        let spec = spec_of("blend", &[("progress_steps", 8.into())]);
        let mut seen = Seen(Vec::new());
        score_anew(&experts, &[toy::episode("a", 70, 9, false)], &spec, &mut seen).unwrap();
        #[expect(clippy::cast_precision_loss, reason = "small numbers")]
        let shares: Vec<f64> = seen.0.iter().map(|(step, total)| *step as f64 / *total as f64).collect();
        assert!(shares.is_sorted(), "{shares:?}");
        assert_eq!((shares.last(), shares.iter().any(|share| *share < 0.5)), (Some(&1.0), true));
    }
}
