//! How well q separates good steps from bad: against the simulator's own mark, which no job ever saw.
//!
//! Must not know a server; the reports of experiments and of the demo use it.

use gleaner_core::statistics::{auroc, auroc_interval, precision_recall};
use gleaner_sim::RecordedEpisode;
use serde::{Deserialize, Serialize};

/// Over all cohorts.
pub(crate) const ALL: &str = "all";
/// Over all cohorts, without the episodes that succeeded nevertheless.
pub(crate) const FAILURES: &str = "failures only";
/// Bins of a histogram of q.
pub(crate) const BINS: usize = 20;
// Of the resampling; any constant will do.
const RESAMPLING_SEED: u64 = 0;

/// The simulator's own verdict on an attempt, which learning must not know.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Mark {
    /// The first step at which it did other than the expert would; `None` when it never did.
    pub(crate) went_wrong: Option<u32>,
}

impl Mark {
    /// Whether the segment that ends at a step is bad: every segment from the first wrong step on. The only definition.
    pub(crate) fn is_bad(&self, end_step: usize) -> bool {
        self.went_wrong.is_some_and(|wrong| end_step >= usize::try_from(wrong).unwrap_or(usize::MAX))
    }
}

impl From<&RecordedEpisode> for Mark {
    fn from(episode: &RecordedEpisode) -> Self {
        Self { went_wrong: episode.went_wrong }
    }
}

/// One imperfect episode: its scores and its mark.
#[derive(Clone, Debug)]
pub(crate) struct MarkedEpisode {
    pub(crate) id: String,
    pub(crate) cohort: String,
    /// Whether it reached the goal nevertheless.
    pub(crate) success: bool,
    pub(crate) mark: Mark,
    /// One value a step.
    pub(crate) q: Vec<f32>,
    /// One value a step.
    pub(crate) w: Vec<f64>,
}

impl MarkedEpisode {
    /// Each step's q, and whether the segment that ends there is good.
    pub(crate) fn steps(&self) -> impl Iterator<Item = (f64, bool)> {
        self.q.iter().enumerate().map(|(step, q)| (f64::from(*q), !self.mark.is_bad(step)))
    }
}

/// Quality over some imperfect episodes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Separation {
    /// A cohort, [`ALL`] or [`FAILURES`].
    pub(crate) cohort: String,
    pub(crate) episodes: usize,
    pub(crate) good_steps: usize,
    pub(crate) wrong_steps: usize,
    /// Mean q of either.
    pub(crate) mean_q_good: Option<f64>,
    pub(crate) mean_q_wrong: Option<f64>,
    /// Chance that a good step has a higher q than a wrong one.
    pub(crate) auroc: Option<f64>,
    /// Its 95 % interval, by resampling episodes.
    pub(crate) interval: Option<(f64, f64)>,
}

/// What a selection keeps.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Selected {
    pub(crate) kept: usize,
    pub(crate) of: usize,
    pub(crate) share: f64,
    /// Share of the kept steps that are good.
    pub(crate) precision: Option<f64>,
    /// Share of the good steps that are kept.
    pub(crate) recall: Option<f64>,
}

/// Overall, of the failures alone if some episodes succeeded and some failed, then for each cohort in the order of
/// their first episodes.
pub(crate) fn separations(episodes: &[MarkedEpisode]) -> Vec<Separation> {
    let mut cohorts: Vec<&str> = Vec::new();
    for episode in episodes {
        if !cohorts.contains(&episode.cohort.as_str()) {
            cohorts.push(&episode.cohort);
        }
    }
    let of =
        |cohort: &str| -> Vec<&MarkedEpisode> { episodes.iter().filter(|episode| episode.cohort == cohort).collect() };
    let mut rows = vec![separation(ALL, &episodes.iter().collect::<Vec<_>>())];
    let failures: Vec<&MarkedEpisode> = episodes.iter().filter(|episode| !episode.success).collect();
    if !failures.is_empty() && failures.len() < episodes.len() {
        rows.push(separation(FAILURES, &failures));
    }
    rows.extend(cohorts.into_iter().map(|cohort| separation(cohort, &of(cohort))));
    rows
}

fn separation(cohort: &str, episodes: &[&MarkedEpisode]) -> Separation {
    let groups: Vec<Vec<(f64, bool)>> = episodes.iter().map(|episode| episode.steps().collect()).collect();
    let steps = groups.concat();
    let of = |good: bool| -> Vec<f64> { steps.iter().filter(|step| step.1 == good).map(|step| step.0).collect() };
    let (good, wrong) = (of(true), of(false));
    Separation {
        cohort: cohort.to_owned(),
        episodes: episodes.len(),
        good_steps: good.len(),
        wrong_steps: wrong.len(),
        mean_q_good: mean(&good),
        mean_q_wrong: mean(&wrong),
        auroc: auroc(&steps),
        interval: auroc_interval(&groups, RESAMPLING_SEED),
    }
}

/// The mean of values; `None` of none.
#[expect(clippy::cast_precision_loss, reason = "counts of steps are far below 2^52")]
pub(crate) fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// Keeps q > β. As on the server both are compared in the precision of q, so that a q equal to β is never kept for
/// how β is rounded.
#[expect(clippy::cast_possible_truncation, reason = "rounded on purpose; β is in [0, 1]")]
pub(crate) fn above(beta: f64) -> impl Fn(f32, f64) -> bool {
    move |q, _| q > beta as f32
}

/// Keeps `count` steps, those of highest q, then of highest w; and every tie with the last of them.
pub(crate) fn best(episodes: &[MarkedEpisode], count: usize) -> impl Fn(f32, f64) -> bool {
    let scores = |episode: &MarkedEpisode| -> Vec<(f32, f64)> {
        episode.q.iter().copied().zip(episode.w.iter().copied()).collect()
    };
    let mut ranked: Vec<(f32, f64)> = episodes.iter().flat_map(scores).collect();
    ranked.sort_by(|one, two| two.0.total_cmp(&one.0).then(two.1.total_cmp(&one.1)));
    let last = count.checked_sub(1).and_then(|index| ranked.get(index).copied());
    move |q, w| last.is_some_and(|(lowest_q, lowest_w)| q > lowest_q || (q == lowest_q && w >= lowest_w))
}

/// The steps that a rule on (q, w) keeps, and how good they are.
#[expect(clippy::cast_precision_loss, reason = "counts of steps are far below 2^52")]
pub(crate) fn select(episodes: &[MarkedEpisode], keeps: impl Fn(f32, f64) -> bool) -> Selected {
    let good: Vec<bool> = episodes.iter().flat_map(MarkedEpisode::steps).map(|step| step.1).collect();
    let scores = episodes.iter().flat_map(|episode| episode.q.iter().zip(&episode.w));
    let kept: Vec<bool> = scores.map(|(q, w)| keeps(*q, *w)).collect();
    let (precision, recall) = precision_recall(&kept, &good);
    let count = kept.iter().filter(|kept| **kept).count();
    Selected { kept: count, of: good.len(), share: count as f64 / good.len().max(1) as f64, precision, recall }
}

/// Steps by their q over [0, 1]: in each of [`BINS`] bins the good and the bad ones.
pub(crate) fn histogram(episodes: &[MarkedEpisode]) -> Vec<[u32; 2]> {
    let mut bins = vec![[0, 0]; BINS];
    for (q, good) in episodes.iter().flat_map(MarkedEpisode::steps) {
        bins[bin(q)][usize::from(!good)] += 1;
    }
    bins
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "q is in [0, 1]; the cast saturates"
)]
fn bin(q: f64) -> usize {
    ((q * BINS as f64) as usize).min(BINS - 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn episodes() -> Vec<MarkedEpisode> {
        let episode = |cohort: &str, went_wrong: Option<u32>, q: &[f32]| MarkedEpisode {
            id: "ep".into(),
            cohort: cohort.into(),
            success: went_wrong.is_none(),
            mark: Mark { went_wrong },
            q: q.to_vec(),
            w: q.iter().map(|q| f64::from(*q) - 1.0).collect(),
        };
        vec![
            episode("freeze", Some(2), &[1.0, 0.75, 0.25, 0.0]),
            episode("wander", Some(1), &[0.5, 0.75]),
            episode("noise", None, &[0.5]),
        ]
    }

    #[test]
    fn steps_before_the_mark_are_good_and_an_unmarked_episode_is_all_good() {
        let rows = separations(&episodes());
        let counts: Vec<_> = rows.iter().map(|r| (r.cohort.as_str(), r.good_steps, r.wrong_steps, r.auroc)).collect();
        // Over all: good 1, .75, .5, .5 against wrong .25, 0, .75: 9.5 of 12 pairs.
        assert_eq!(
            counts,
            [
                ("all", 4, 3, Some(9.5 / 12.0)),
                // Without noise's .5: good 1, .75, .5 against the same wrong ones.
                ("failures only", 3, 3, Some(7.5 / 9.0)),
                ("freeze", 2, 2, Some(1.0)),
                ("wander", 1, 1, Some(0.0)),
                ("noise", 1, 0, None),
            ]
        );
        assert_eq!(rows[2].mean_q_good, Some(0.875));
        assert_eq!(rows[4].mean_q_wrong, None);
    }

    #[test]
    fn a_selection_keeps_the_segments_of_its_rule() {
        let half = select(&episodes(), above(0.5));
        assert_eq!((half.kept, half.of, half.precision, half.recall), (3, 7, Some(2.0 / 3.0), Some(0.5)));
        assert!((half.share - 3.0 / 7.0).abs() < 1e-12);
        let nothing = select(&episodes(), above(1.0));
        assert_eq!((nothing.kept, nothing.precision, nothing.recall), (0, None, Some(0.0)));
        // 1, 0.75 and, with it, the other 0.75.
        assert_eq!(select(&episodes(), best(&episodes(), 2)).kept, 3);
        assert_eq!(select(&episodes(), best(&episodes(), 0)).kept, 0);
        assert!(!above(0.6)(0.6, 0.0), "rounded as q is");
    }

    #[test]
    fn a_histogram_holds_every_step_once() {
        let bins = histogram(&episodes());
        assert_eq!((bins[0], bins[5], bins[10], bins[15], bins[19]), ([0, 1], [0, 1], [2, 0], [1, 1], [1, 0]));
        assert_eq!(bins.iter().flatten().sum::<u32>(), 7);
        assert_eq!([bin(0.0), bin(0.05), bin(0.999), bin(1.0)], [0, 1, 19, 19]);
    }
}
