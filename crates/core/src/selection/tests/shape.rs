//! Shapes, compared with their definition written out step by step.

use proptest::prelude::*;
use serde_json::json;

use super::{
    super::{shape::share, *},
    count,
};
use crate::Values;

/// The steps of each expert.
const LENGTHS: [u64; 2] = [7, 10];

/// Scores of one episode; matches are (expert, step), or empty.
#[derive(Debug, Clone)]
struct Scored {
    candidate: Candidate,
    matches: Vec<(u32, u32)>,
}

fn scored(scores: &[(f32, f64)], matches: Vec<(u32, u32)>) -> Scored {
    let (experts, steps): (Vec<u32>, Vec<u32>) = matches.iter().copied().unzip();
    let candidate = Candidate {
        episode_id: EpisodeId::new(),
        cohort: String::new(),
        w: scores.iter().map(|(_, w)| *w).collect(),
        q: scores.iter().map(|(q, _)| *q).collect(),
        places: places(&experts, &steps, &LENGTHS).unwrap(),
    };
    Scored { candidate, matches }
}

/// An episode that the rule q > 0.5 keeps where the text has an x.
fn drawn(text: &str) -> Candidate {
    let scores: Vec<(f32, f64)> = text.bytes().map(|byte| if byte == b'x' { (0.9, 0.0) } else { (0.1, 0.0) }).collect();
    scored(&scores, Vec::new()).candidate
}

fn shaped(given: serde_json::Value) -> Selection {
    let values: Values = serde_json::from_value(given).unwrap();
    Selection { shape: SelectionShape::from_values(&values).unwrap(), ..Selection::beta(0.5) }
}

fn kept(selection: Selection, candidates: &[Candidate]) -> Vec<Vec<bool>> {
    let ranked = ranked(candidates);
    let resolved = Resolved::new(selection, &ranked, candidates, &ExpertRanking::default());
    let mark = |candidate: &Candidate| {
        let mut kept = vec![true; 3];
        resolved.mark(candidate, &mut kept);
        kept
    };
    candidates.iter().map(mark).collect()
}

fn picture(selection: Selection, text: &str) -> String {
    let marks = kept(selection, &[drawn(text)]).remove(0);
    marks.into_iter().map(|kept| if kept { 'x' } else { '.' }).collect()
}

/// The example of `docs/selection.md`.
#[test]
fn each_step_of_the_documented_example_is_as_drawn() {
    let rule = "..xxx.xx....x.......xxxx..";
    assert_eq!(picture(Selection::beta(0.5), rule), rule);
    for (shape, expected) in [
        (json!({"close_gaps": 1}), "..xxxxxx....x.......xxxx.."),
        (json!({"close_gaps": 1, "min_run": 3}), "..xxxxxx............xxxx.."),
        (json!({"close_gaps": 1, "min_run": 3, "context_before": 4, "context_after": 1}), "xxxxxxxxx.......xxxxxxxxx."),
    ] {
        assert_eq!(picture(shaped(shape.clone()), rule), expected, "{shape}");
    }
}

#[test]
fn runs_meet_the_ends_of_an_episode() {
    assert_eq!(picture(shaped(json!({"close_gaps": 9})), "..x..x.."), "..xxxx..", "only gaps between runs are closed");
    assert_eq!(picture(shaped(json!({"context_before": 1_000_000})), "...x"), "xxxx");
    assert_eq!(picture(shaped(json!({"context_after": 1_000_000})), "x..."), "xxxx");
    assert_eq!(picture(shaped(json!({"min_run": 5})), "xxxx"), "....");
    assert_eq!(picture(shaped(json!({"min_run": 4})), "xxxx"), "xxxx");
    assert_eq!(picture(shaped(json!({"close_gaps": 3, "context_before": 2})), ""), "");
}

#[test]
fn frequent_phases_do_not_crowd_out_rare_ones() {
    // A thousand good segments match the first half of an expert, ten the second.
    let reaches = scored(&[(0.9, 0.0); 1000], vec![(1, 2); 1000]).candidate;
    let grasps = scored(&[(0.8, 0.0); 10], vec![(1, 7); 10]).candidate;
    let selection = shaped(json!({"phases": 2, "max_per_phase": 20}));
    let counted = count(&[selection], &[reaches, grasps]).remove(0);
    assert_eq!(counted.episodes.iter().map(|(_, kept, _)| *kept).collect::<Vec<_>>(), [20, 10]);
}

#[test]
fn shares_are_rounded_down_and_products_are_not() {
    assert_eq!((share(0.29, 100), share(0.5, 3), share(0.1, 9), share(0.07, 100)), (29, 1, 0, 7));
}

#[test]
fn a_shape_is_off_by_default_and_described_by_its_changes() {
    let off = SelectionShape::default();
    assert!(off.is_off() && off.changed().is_empty() && off.to_string().is_empty());
    let shape = shaped(json!({"min_run": 5, "max_share_of_episode": 0.25, "phases": 10})).shape;
    assert_eq!(shape.to_string(), "min_run 5, max_share_of_episode 0.25");
    assert_eq!(serde_json::Value::Object(shape.changed()), json!({"min_run": 5, "max_share_of_episode": 0.25}));
    assert_eq!(SelectionShape::from_values(&shape.changed()).unwrap(), shape);
    let selection = Selection { shape, ..Selection::beta(0.5) };
    assert_eq!(serde_json::to_value(Selection::beta(0.5)).unwrap(), json!({"beta": 0.5}));
    assert_eq!(serde_json::to_value(selection).unwrap()["shape"]["min_run"], 5);
}

#[test]
fn a_wrong_shape_is_named() {
    let problem = |given: serde_json::Value| {
        let values: Values = serde_json::from_value(given).unwrap();
        SelectionShape::from_values(&values).unwrap_err().to_string()
    };
    assert!(problem(json!({"min_runs": 5})).starts_with("min_runs: unknown setting; supported: min_expert_auroc, "));
    assert_eq!(problem(json!({"phases": 0})), "phases: is 0, must be between 1 and 1000");
    // Without effect, so that no second dataset has the same segments.
    assert!(shaped(json!({"min_run": 1, "phases": 20})).shape.is_off());
    for share in [0.0, 1.5, f64::NAN] {
        let shape = SelectionShape { max_share_of_episode: share, ..SelectionShape::default() };
        assert_eq!(shape.checked().unwrap_err().field, "max_share_of_episode");
    }
    let auroc = SelectionShape { min_expert_auroc: 1.5, ..SelectionShape::default() };
    assert_eq!(auroc.checked().unwrap_err().field, "min_expert_auroc");
    assert!(SelectionShape::default().checked().unwrap().is_off());
}

/// What a selection keeps, by the definitions of its settings.
fn defined(selection: Selection, episodes: &[Scored]) -> Vec<Vec<bool>> {
    let candidates: Vec<Candidate> = episodes.iter().map(|one| one.candidate.clone()).collect();
    let (filter, shape) = (Filter::new(selection.rule, &ranked(&candidates)), selection.shape);
    let of = |count: u32| usize::try_from(count).unwrap();
    let mut all: Vec<Vec<bool>> = Vec::new();
    for one in &candidates {
        let by_rule: Vec<bool> = one.w.iter().zip(&one.q).map(|(&w, &q)| filter.keeps(w, q)).collect();
        let steps = 0..by_rule.len();
        // In a gap: the kept neighbours on either side are at most a gap apart.
        let in_gap = |step: usize| {
            let before = (0..step).rev().find(|&other| by_rule[other]);
            let after = (step..by_rule.len()).find(|&other| by_rule[other]);
            before.zip(after).is_some_and(|(before, after)| after - before - 1 <= of(shape.close_gaps))
        };
        let closed: Vec<bool> = steps.clone().map(|step| by_rule[step] || in_gap(step)).collect();
        let run = |step: usize| {
            let before = (0..=step).rev().take_while(|&other| closed[other]).count();
            before + (step + 1..closed.len()).take_while(|&other| closed[other]).count()
        };
        let long: Vec<bool> = steps.clone().map(|step| closed[step] && run(step) >= of(shape.min_run)).collect();
        let near = |step: usize| {
            (0..long.len()).any(|other| {
                long[other] && step + of(shape.context_before) >= other && step <= other + of(shape.context_after)
            })
        };
        let mut kept: Vec<bool> = steps.clone().map(near).collect();
        let mut best: Vec<usize> = steps.filter(|&step| kept[step]).collect();
        best.sort_by(|&a, &b| one.ranked(a).order(&one.ranked(b)));
        if shape.max_share_of_episode < 1.0 {
            let dropped = best.iter().skip(share(shape.max_share_of_episode, kept.len()));
            dropped.for_each(|&step| kept[step] = false);
        }
        all.push(kept);
    }
    if shape.max_per_phase > 0 {
        let phase = |place: usize, step: usize| {
            let (at, length) = match episodes[place].matches.get(step) {
                Some(&(expert, at)) => (u64::from(at), LENGTHS[of(expert)]),
                None => (step as u64, episodes[place].candidate.q.len() as u64),
            };
            at * u64::from(shape.phases) / length
        };
        let mut best: Vec<(usize, usize)> = Vec::new();
        for (place, kept) in all.iter().enumerate() {
            best.extend((0..kept.len()).filter(|&step| kept[step]).map(|step| (place, step)));
        }
        best.sort_by(|a, b| candidates[a.0].ranked(a.1).order(&candidates[b.0].ranked(b.1)));
        let mut counts = std::collections::BTreeMap::<u64, u32>::new();
        for (place, step) in best {
            let count = counts.entry(phase(place, step)).or_default();
            *count += 1;
            all[place][step] = *count <= shape.max_per_phase;
        }
    }
    all
}

/// Few different scores, so that ties are common; every second episode is of a scorer without matches.
fn episodes() -> impl Strategy<Value = Vec<Scored>> {
    let score = (0..4_u8, 0..3_u8).prop_map(|(q, w)| (f32::from(q) / 3.0, -f64::from(w)));
    let step = (score, 0..2_u32, 0..7_u32).prop_map(|(score, expert, at)| (score, (expert, at)));
    let one = (proptest::collection::vec(step, 0..16), any::<bool>()).prop_map(|(steps, matched)| {
        let (scores, matches): (Vec<_>, Vec<_>) = steps.into_iter().unzip();
        scored(&scores, if matched { matches } else { Vec::new() })
    });
    proptest::collection::vec(one, 0..6)
}

prop_compose! {
    fn shape()(
        close_gaps in 0..4_u32, min_run in 0..4_u32, context_before in 0..3_u32, context_after in 0..3_u32,
        share in 1..=8_u8, phases in 1..5_u32, max_per_phase in 0..6_u32,
    ) -> SelectionShape {
        let max_share_of_episode = f64::from(share) / 8.0;
        SelectionShape {
            min_expert_auroc: 0.0, close_gaps, min_run, context_before, context_after, max_share_of_episode, phases,
            max_per_phase,
        }
    }
}

fn selection() -> impl Strategy<Value = Selection> {
    (super::selection(), shape()).prop_map(|(selection, shape)| Selection { shape, ..selection })
}

fn subset(less: &[Vec<bool>], more: &[Vec<bool>]) -> bool {
    less.iter().flatten().zip(more.iter().flatten()).all(|(less, more)| *more || !*less)
}

proptest! {
    #[test]
    fn kept_segments_are_those_of_the_definition(episodes in episodes(), selection in selection()) {
        let candidates: Vec<Candidate> = episodes.iter().map(|one| one.candidate.clone()).collect();
        let kept = kept(selection, &candidates);
        prop_assert_eq!(&kept, &defined(selection, &episodes));
        let counted = count(&[selection], &candidates).remove(0);
        let counts: Vec<u64> = counted.episodes.iter().map(|(_, kept, _)| *kept).collect();
        prop_assert_eq!(counts, kept.iter().map(|one| one.iter().filter(|kept| **kept).count() as u64).collect::<Vec<_>>());
    }

    #[test]
    fn a_shape_that_is_off_changes_no_selection(episodes in episodes(), selection in super::selection()) {
        let candidates: Vec<Candidate> = episodes.into_iter().map(|one| one.candidate).collect();
        let filter = Filter::new(selection.rule, &ranked(&candidates));
        let by_rule = |one: &Candidate| one.w.iter().zip(&one.q).map(|(&w, &q)| filter.keeps(w, q)).collect();
        prop_assert_eq!(kept(selection, &candidates), candidates.iter().map(by_rule).collect::<Vec<Vec<bool>>>());
        let one_step = Selection { shape: SelectionShape { min_run: 1, ..selection.shape }, ..selection };
        prop_assert_eq!(kept(one_step, &candidates), kept(selection, &candidates));
    }

    #[test]
    fn the_order_of_episodes_changes_no_selection(episodes in episodes(), selection in selection(), turn in 0..6_usize) {
        let candidates: Vec<Candidate> = episodes.into_iter().map(|one| one.candidate).collect();
        let by_episode = |candidates: &[Candidate]| {
            let ids = candidates.iter().map(|one| one.episode_id.clone());
            ids.zip(kept(selection, candidates)).collect::<std::collections::BTreeMap<_, _>>()
        };
        let mut turned = candidates.clone();
        turned.rotate_left(turn % candidates.len().max(1));
        prop_assert_eq!(by_episode(&turned), by_episode(&candidates));
        turned.reverse();
        prop_assert_eq!(by_episode(&turned), by_episode(&candidates));
    }

    #[test]
    fn gaps_and_context_add_segments_and_the_rest_drops_some(episodes in episodes(), selection in selection()) {
        let candidates: Vec<Candidate> = episodes.into_iter().map(|one| one.candidate).collect();
        let off = SelectionShape::default();
        let of = |shape: SelectionShape| kept(Selection { shape, ..selection }, &candidates);
        let SelectionShape { close_gaps, min_run, context_before, context_after, .. } = selection.shape;
        let gaps = SelectionShape { close_gaps, ..off };
        prop_assert!(subset(&of(off), &of(gaps)));
        let long = SelectionShape { min_run, ..gaps };
        prop_assert!(subset(&of(long), &of(gaps)));
        let context = SelectionShape { context_before, context_after, ..long };
        prop_assert!(subset(&of(long), &of(context)));
        let limited = SelectionShape { max_share_of_episode: selection.shape.max_share_of_episode, ..context };
        prop_assert!(subset(&of(limited), &of(context)));
        prop_assert!(subset(&of(selection.shape), &of(limited)));
    }
}
