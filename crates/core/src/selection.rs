//! Selections: the imperfect segments of a score run to keep, and the counts that other selections would keep.

use std::collections::BTreeMap;

use super::id::EpisodeId;

/// The imperfect segments to keep.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Selection {
    /// q > β, the paper's filter; β is in [0, 1].
    Beta(f64),
    /// This part, in (0, 1], of the run's imperfect segments: those of highest q, and among equal q those of highest w.
    TopFraction(f64),
}

/// A selection resolved for one run: decides from one segment's scores whether it is kept.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Filter {
    /// q above this.
    Above(f64),
    /// At least this (q, w): a higher q, or the same q and no lower w.
    AtLeast(f32, f64),
    /// No segment, because the run has no imperfect segment.
    Nothing,
}

impl Filter {
    /// The filter of a selection, given the (q, w) of all the run's imperfect segments. `ranked` goes from best to
    /// worst; only a top fraction reads it.
    ///
    /// A top fraction keeps every segment at least as good as the k-th best, k = ⌈fraction · N⌉, so segments that tie
    /// with the k-th are kept too.
    pub fn new(selection: Selection, ranked: &[(f32, f64)]) -> Self {
        match selection {
            Selection::Beta(beta) => Self::Above(beta),
            Selection::TopFraction(fraction) => {
                ranked.get(rank(fraction, ranked.len()) - 1).map_or(Self::Nothing, |&(q, w)| Self::AtLeast(q, w))
            }
        }
    }

    /// Whether a segment is kept.
    ///
    /// q and β are compared in the precision in which q is stored, so that the rounding of β never keeps a q equal to
    /// β.
    #[expect(clippy::cast_possible_truncation, reason = "rounded on purpose, see above; β is in [0, 1]")]
    pub fn keeps(self, w: f64, q: f32) -> bool {
        match self {
            Self::Above(beta) => q > beta as f32,
            Self::AtLeast(lowest_q, lowest_w) => q > lowest_q || q == lowest_q && w >= lowest_w,
            Self::Nothing => false,
        }
    }
}

/// ⌈fraction · N⌉, at least 1, corrected for the rounding of the product: 7 % of 100 is 7.
#[expect(clippy::cast_precision_loss, reason = "far fewer than 2^52 segments")]
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "between 0 and N")]
fn rank(fraction: f64, segments: usize) -> usize {
    ((fraction * segments as f64 * (1.0 - 1e-12)).ceil() as usize).max(1)
}

/// (q, w) of every segment from best to worst, as an argument of [`Filter::new`].
pub fn ranked(candidates: &[Candidate]) -> Vec<(f32, f64)> {
    let pairs = candidates.iter().flat_map(|one| one.q.iter().copied().zip(one.w.iter().copied()));
    let mut ranked: Vec<(f32, f64)> = pairs.collect();
    ranked.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(b.1.total_cmp(&a.1)));
    ranked
}

/// One imperfect episode of a run, with the values that a selection reads.
#[derive(Debug, Clone)]
pub struct Candidate {
    /// The episode.
    pub episode_id: EpisodeId,
    /// Its cohort in the run's snapshot.
    pub cohort: String,
    /// w of every segment.
    pub w: Vec<f64>,
    /// q of every segment.
    pub q: Vec<f32>,
}

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

/// The part that each selection would keep of the run's imperfect episodes, given in the snapshot's order.
pub fn count(selections: &[Selection], candidates: &[Candidate]) -> Vec<WhatIf> {
    let ranks = selections.iter().any(|selection| matches!(selection, Selection::TopFraction(_)));
    let ranked = if ranks { ranked(candidates) } else { Vec::new() };
    selections.iter().map(|&selection| what_if(selection, &ranked, candidates)).collect()
}

/// The part that one selection would keep. Only a top fraction reads `ranked`, the (q, w) from best to worst.
pub fn what_if(selection: Selection, ranked: &[(f32, f64)], candidates: &[Candidate]) -> WhatIf {
    let filter = Filter::new(selection, ranked);
    let (mut total, mut threshold) = (Kept::default(), None::<f64>);
    let (mut cohorts, mut episodes) = (BTreeMap::<String, Kept>::new(), Vec::with_capacity(candidates.len()));
    for candidate in candidates {
        let (mut kept, mut of) = (0, 0);
        for (&w, &q) in candidate.w.iter().zip(&candidate.q) {
            of += 1;
            if filter.keeps(w, q) {
                kept += 1;
                threshold = Some(threshold.map_or(w, |lowest| lowest.min(w)));
            }
        }
        total.add(kept, of);
        match cohorts.get_mut(&candidate.cohort) {
            Some(cohort) => cohort.add(kept, of),
            None => cohorts.entry(candidate.cohort.clone()).or_default().add(kept, of),
        }
        episodes.push((candidate.episode_id.clone(), kept, of));
    }
    WhatIf { selection, threshold, total, cohorts, episodes }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn candidate(cohort: &str, q: &[f32]) -> Candidate {
        Candidate {
            episode_id: EpisodeId::new(),
            cohort: cohort.into(),
            w: q.iter().map(|&q| f64::from(q) - 1.0).collect(),
            q: q.to_vec(),
        }
    }

    #[test]
    fn the_threshold_is_strict_and_rounds_as_q_does() {
        // 0.6 as f32 lies above 0.6 as f64.
        assert!(!Filter::Above(0.6).keeps(0.0, 0.6));
        assert!(Filter::Above(0.6).keeps(0.0, 0.600_001));
        assert!(!Filter::Above(1.0).keeps(0.0, 1.0));
    }

    #[test]
    fn a_top_fraction_keeps_the_best_and_their_ties() {
        // q decides first, and w only between equal q: the last segment has the highest w and the lowest q.
        let (q, w) = (vec![0.25, 1.0, 0.5, 0.5, 0.5, 0.0], vec![-3.0, -1.0, -2.0, -2.0, -2.5, -0.5]);
        let ranked = ranked(&[Candidate { w, q, ..candidate("", &[]) }]);
        for (fraction, q, w) in [
            (0.1, 1.0, -1.0),
            (0.2, 0.5, -2.0),
            (0.5, 0.5, -2.0),
            (0.6, 0.5, -2.5),
            (0.7, 0.25, -3.0),
            (1.0, 0.0, -0.5),
        ] {
            let filter = Filter::new(Selection::TopFraction(fraction), &ranked);
            assert_eq!(filter, Filter::AtLeast(q, w), "{fraction}");
            assert!(filter.keeps(w, q) && filter.keeps(w - 1.0, q + 0.1) && !filter.keeps(w - 0.1, q));
        }
        assert_eq!(Filter::new(Selection::TopFraction(0.5), &[]), Filter::Nothing);
        assert_eq!((rank(0.07, 100), rank(0.1, 30), rank(1e-9, 30), rank(0.5, 3)), (7, 3, 1, 2));
    }

    #[test]
    fn counts_equal_those_of_a_scan_of_all_segments() {
        let candidates = [candidate("b", &[0.1, 0.9, 0.95]), candidate("a", &[0.5, 0.2]), candidate("b", &[])];
        let counts = count(&[Selection::Beta(0.9), Selection::TopFraction(0.6), Selection::Beta(1.0)], &candidates);
        let kept = |segments, of_segments, episodes, of_episodes| Kept { segments, of_segments, episodes, of_episodes };
        assert_eq!(counts[0].total, kept(1, 5, 1, 3));
        assert_eq!(counts[0].cohorts["b"], kept(1, 3, 1, 2));
        assert_eq!(counts[0].cohorts["a"], kept(0, 2, 0, 1));
        assert_eq!(counts[0].threshold, Some(f64::from(0.95_f32) - 1.0));
        assert_eq!(counts[1].total, kept(3, 5, 2, 3));
        assert_eq!(counts[1].threshold, Some(-0.5));
        let episodes: Vec<_> = counts[1].episodes.iter().map(|(_, kept, of)| (*kept, *of)).collect();
        assert_eq!(episodes, [(2, 3), (1, 2), (0, 0)]);
        assert_eq!((counts[2].threshold, counts[2].total.segments), (None, 0));
    }

    /// Episodes with few different scores, so that ties are common.
    fn candidates() -> impl Strategy<Value = Vec<Candidate>> {
        let score = (0..8_u8, 0..4_u8).prop_map(|(q, w)| (f32::from(q) / 7.0, -f64::from(w)));
        let one = ("[ab]", proptest::collection::vec(score, 0..12)).prop_map(|(cohort, scores)| Candidate {
            episode_id: EpisodeId::new(),
            cohort,
            w: scores.iter().map(|(_, w)| *w).collect(),
            q: scores.iter().map(|(q, _)| *q).collect(),
        });
        proptest::collection::vec(one, 0..6)
    }

    fn selection() -> impl Strategy<Value = Selection> {
        prop_oneof![(0.0..=1.0_f64).prop_map(Selection::Beta), (0.001..=1.0_f64).prop_map(Selection::TopFraction)]
    }

    proptest! {
        #[test]
        fn counts_add_up_and_match_the_filter(candidates in candidates(), selection in selection()) {
            let counted = count(&[selection], &candidates).remove(0);
            let filter = Filter::new(selection, &ranked(&candidates));
            let kept = |one: &Candidate| one.w.iter().zip(&one.q).filter(|&(&w, &q)| filter.keeps(w, q)).count() as u64;
            let each: Vec<u64> = candidates.iter().map(kept).collect();
            prop_assert_eq!(counted.episodes.iter().map(|(_, kept, _)| *kept).collect::<Vec<_>>(), each.clone());
            let Kept { segments, of_segments, episodes, of_episodes } = counted.total;
            prop_assert_eq!(segments, each.iter().sum::<u64>());
            prop_assert_eq!(of_segments, candidates.iter().map(|one| one.w.len() as u64).sum::<u64>());
            prop_assert_eq!(episodes, each.iter().filter(|&&kept| kept > 0).count() as u64);
            prop_assert_eq!(of_episodes, candidates.len() as u64);
            let of_cohorts = counted.cohorts.values().fold(Kept::default(), |sum, kept| Kept {
                segments: sum.segments + kept.segments,
                of_segments: sum.of_segments + kept.of_segments,
                episodes: sum.episodes + kept.episodes,
                of_episodes: sum.of_episodes + kept.of_episodes,
            });
            prop_assert_eq!(of_cohorts, counted.total);
            prop_assert_eq!(counted.threshold.is_some(), segments > 0);
            if let Selection::TopFraction(fraction) = selection && of_segments > 0 {
                prop_assert!(segments >= rank(fraction, usize::try_from(of_segments).unwrap()) as u64);
            }
        }

        /// A stricter rule keeps no more.
        #[test]
        fn keeping_less_is_a_subset(candidates in candidates(), one in 0.0..=1.0_f64, other in 0.0..=1.0_f64) {
            let (low, high) = if one < other { (one, other) } else { (other, one) };
            let counted = count(&[Selection::Beta(low), Selection::Beta(high)], &candidates);
            prop_assert!(counted[1].total.segments <= counted[0].total.segments);
            let fractions = [Selection::TopFraction(low.max(0.001)), Selection::TopFraction(high.max(0.001))];
            let counted = count(&fractions, &candidates);
            prop_assert!(counted[0].total.segments <= counted[1].total.segments);
        }
    }
}
