//! Rules, shapes and counts, compared with definitions written out.

use proptest::prelude::*;

use super::{rule::rank, *};

mod cohorts;
mod shape;

fn candidate(cohort: &str, q: &[f32]) -> Candidate {
    Candidate {
        episode_id: EpisodeId::new(),
        cohort: cohort.into(),
        w: q.iter().map(|&q| f64::from(q) - 1.0).collect(),
        q: q.to_vec(),
        places: Vec::new(),
    }
}

/// The part that each selection would keep.
fn count(selections: &[Selection], candidates: &[Candidate]) -> Vec<WhatIf> {
    let ranked = ranked(candidates);
    selections.iter().map(|&selection| what_if(selection, &ranked, candidates, &ExpertRanking::default())).collect()
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
    for (fraction, q, w) in
        [(0.1, 1.0, -1.0), (0.2, 0.5, -2.0), (0.5, 0.5, -2.0), (0.6, 0.5, -2.5), (0.7, 0.25, -3.0), (1.0, 0.0, -0.5)]
    {
        let filter = Filter::new(Rule::TopFraction(fraction), &ranked);
        assert_eq!(filter, Filter::AtLeast(q, w), "{fraction}");
        assert!(filter.keeps(w, q) && filter.keeps(w - 1.0, q + 0.1) && !filter.keeps(w - 0.1, q));
    }
    assert_eq!(Filter::new(Rule::TopFraction(0.5), &[]), Filter::Nothing);
    assert_eq!((rank(0.07, 100), rank(0.1, 30), rank(1e-9, 30), rank(0.5, 3)), (7, 3, 1, 2));
}

#[test]
fn counts_equal_those_of_a_scan_of_all_segments() {
    let candidates = [candidate("b", &[0.1, 0.9, 0.95]), candidate("a", &[0.5, 0.2]), candidate("b", &[])];
    let counts = count(&[Selection::beta(0.9), Selection::top_fraction(0.6), Selection::beta(1.0)], &candidates);
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
        places: Vec::new(),
    });
    proptest::collection::vec(one, 0..6)
}

fn selection() -> impl Strategy<Value = Selection> {
    prop_oneof![(0.0..=1.0_f64).prop_map(Selection::beta), (0.001..=1.0_f64).prop_map(Selection::top_fraction)]
}

proptest! {
    #[test]
    fn counts_add_up_and_match_the_filter(candidates in candidates(), selection in selection()) {
        let counted = count(&[selection], &candidates).remove(0);
        let filter = Filter::new(selection.rule, &ranked(&candidates));
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
        if let Rule::TopFraction(fraction) = selection.rule && of_segments > 0 {
            prop_assert!(segments >= rank(fraction, usize::try_from(of_segments).unwrap()) as u64);
        }
    }

    /// A stricter rule keeps no more.
    #[test]
    fn keeping_less_is_a_subset(candidates in candidates(), one in 0.0..=1.0_f64, other in 0.0..=1.0_f64) {
        let (low, high) = if one < other { (one, other) } else { (other, one) };
        let counted = count(&[Selection::beta(low), Selection::beta(high)], &candidates);
        prop_assert!(counted[1].total.segments <= counted[0].total.segments);
        let fractions = [Selection::top_fraction(low.max(0.001)), Selection::top_fraction(high.max(0.001))];
        let counted = count(&fractions, &candidates);
        prop_assert!(counted[0].total.segments <= counted[1].total.segments);
    }
}
