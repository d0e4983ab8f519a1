//! How well q separates good steps from bad: against the simulator's own mark, which no job ever saw.
//!
//! Must not know a server; the reports of experiments and of the demo use it.

use gleaner_core::selection::{Candidate, ExpertRanking, Resolved, Selection, ranked};
use gleaner_core::statistics::{auroc, auroc_difference, auroc_interval, precision_recall};
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
    /// The first step after a false start; `None` if it began as the expert would.
    pub(crate) went_right: Option<u32>,
    /// The first step, after a false start, at which it did other than the expert would; `None` when it never did.
    pub(crate) went_wrong: Option<u32>,
}

impl Mark {
    /// Whether the segment that ends at a step is bad: every segment of a false start, and from the first wrong step on. The
    /// only definition.
    pub(crate) fn is_bad(&self, end_step: usize) -> bool {
        let end_step = u32::try_from(end_step).unwrap_or(u32::MAX);
        self.went_right.is_some_and(|right| end_step < right) || self.went_wrong.is_some_and(|wrong| end_step >= wrong)
    }
}

impl From<&RecordedEpisode> for Mark {
    fn from(episode: &RecordedEpisode) -> Self {
        Self { went_right: episode.went_right, went_wrong: episode.went_wrong }
    }
}

/// One imperfect episode: its scores and its mark.
#[derive(Clone, Debug)]
pub(crate) struct MarkedEpisode {
    pub(crate) scores: Candidate,
    /// Whether it reached the goal nevertheless.
    pub(crate) success: bool,
    pub(crate) mark: Mark,
}

impl MarkedEpisode {
    /// Each step's q, and whether the segment that ends there is good.
    pub(crate) fn steps(&self) -> impl Iterator<Item = (f64, bool)> {
        self.scores.q.iter().enumerate().map(|(step, q)| (f64::from(*q), !self.mark.is_bad(step)))
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
        if !cohorts.contains(&episode.scores.cohort.as_str()) {
            cohorts.push(&episode.scores.cohort);
        }
    }
    let of = |cohort: &str| -> Vec<&MarkedEpisode> {
        episodes.iter().filter(|episode| episode.scores.cohort == cohort).collect()
    };
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

/// By how much one scorer separates better than another, with a 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Lead {
    pub(crate) difference: f64,
    pub(crate) low: f64,
    pub(crate) high: f64,
}

/// The AUROC of one run less that of another over all cohorts; `None` if they have different episodes, or one class.
pub(crate) fn lead(one: &[MarkedEpisode], other: &[MarkedEpisode]) -> Option<Lead> {
    let same = |(one, other): (&MarkedEpisode, &MarkedEpisode)| one.scores.episode_id == other.scores.episode_id;
    if one.len() != other.len() || !one.iter().zip(other).all(same) {
        return None;
    }
    let steps = |episodes: &[MarkedEpisode]| -> Vec<Vec<(f64, bool)>> {
        episodes.iter().map(|episode| episode.steps().collect()).collect()
    };
    let (difference, low, high) = auroc_difference(&steps(one), &steps(other), RESAMPLING_SEED)?;
    Some(Lead { difference, low, high })
}

/// The mean of values; `None` of none.
#[expect(clippy::cast_precision_loss, reason = "counts of steps are far below 2^52")]
pub(crate) fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// The steps that a selection keeps, and how good they are. `ranking` is the run's.
pub(crate) fn select(episodes: &[MarkedEpisode], selection: Selection, ranking: &ExpertRanking) -> Selected {
    select_among(episodes, episodes.len(), selection, ranking)
}

/// As [`select`], of the first `marked` episodes alone; all of them compete.
#[expect(clippy::cast_precision_loss, reason = "counts of steps are far below 2^52")]
pub(crate) fn select_among(
    episodes: &[MarkedEpisode],
    marked: usize,
    selection: Selection,
    ranking: &ExpertRanking,
) -> Selected {
    let candidates: Vec<Candidate> = episodes.iter().map(|episode| episode.scores.clone()).collect();
    let ranked = ranked(&candidates);
    let (resolved, mut of_episode) = (Resolved::new(selection, &ranked, &candidates, ranking), Vec::new());
    let (mut kept, mut good) = (Vec::new(), Vec::new());
    for episode in episodes.iter().take(marked) {
        resolved.mark(&episode.scores, &mut of_episode);
        kept.extend_from_slice(&of_episode);
        good.extend(episode.steps().map(|step| step.1));
    }
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
    use gleaner_core::{id::EpisodeId, selection::SelectionShape};

    use super::*;

    fn episodes() -> Vec<MarkedEpisode> {
        let episode = |cohort: &str, went_wrong: Option<u32>, q: &[f32]| MarkedEpisode {
            scores: Candidate {
                episode_id: EpisodeId::new(),
                cohort: cohort.into(),
                w: q.iter().map(|q| f64::from(*q) - 1.0).collect(),
                q: q.to_vec(),
                places: Vec::new(),
            },
            success: went_wrong.is_none(),
            mark: Mark { went_right: None, went_wrong },
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
    fn a_selection_keeps_the_segments_of_its_rule_and_shape() {
        let unread = ExpertRanking::default();
        let half = select(&episodes(), Selection::beta(0.5), &unread);
        assert_eq!((half.kept, half.of, half.precision, half.recall), (3, 7, Some(2.0 / 3.0), Some(0.5)));
        assert!((half.share - 3.0 / 7.0).abs() < 1e-12);
        let nothing = select(&episodes(), Selection::beta(1.0), &unread);
        assert_eq!((nothing.kept, nothing.precision, nothing.recall), (0, None, Some(0.0)));
        // 1, 0.75 and, with it, the other 0.75.
        assert_eq!(select(&episodes(), Selection::top_fraction(2.0 / 7.0), &unread).kept, 3);
        // The first two of freeze are a run of two; wander's last is alone.
        let shape = SelectionShape { min_run: 2, ..SelectionShape::default() };
        let runs = select(&episodes(), Selection { shape, ..Selection::beta(0.5) }, &unread);
        assert_eq!((runs.kept, runs.precision, runs.recall), (2, Some(1.0), Some(0.5)));
    }

    #[test]
    fn a_histogram_holds_every_step_once() {
        let bins = histogram(&episodes());
        assert_eq!((bins[0], bins[5], bins[10], bins[15], bins[19]), ([0, 1], [0, 1], [2, 0], [1, 1], [1, 0]));
        assert_eq!(bins.iter().flatten().sum::<u32>(), 7);
        assert_eq!([bin(0.0), bin(0.05), bin(0.999), bin(1.0)], [0, 1, 19, 19]);
    }
}
