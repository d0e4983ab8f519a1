//! Cohorts that a selection leaves out for their rank beside experts.

use super::*;

fn shaped(min_expert_auroc: f64, shape: SelectionShape) -> Selection {
    Selection { shape: SelectionShape { min_expert_auroc, ..shape }, ..Selection::beta(0.5) }
}

#[test]
fn cohorts_that_rank_above_experts_are_left_out() {
    // Of four pairs each, the expert wins four, one and two.
    let candidates = [
        candidate("dropped", &[0.6, 0.1]),
        candidate("wrong", &[0.95, 0.7, 0.9, 0.85]),
        candidate("", &[0.9, 0.75]),
        candidate("wrong", &[]),
    ];
    let ranking = ExpertRanking::of_candidates(&candidates, vec![0.8, 0.8]);
    assert_eq!(ranking.below(0.5).collect::<Vec<_>>(), ["wrong"]);
    let counts = |selection: Selection| {
        let counted = what_if(selection, &ranked(&candidates), &candidates, &ranking);
        counted.episodes.iter().map(|(_, kept, _)| *kept).collect::<Vec<_>>()
    };
    let off = SelectionShape::default();
    assert_eq!(counts(shaped(0.0, off)), [1, 4, 2, 0], "off by default");
    assert_eq!(counts(shaped(0.5, off)), [1, 0, 2, 0], "half of the pairs are not less than half");
    assert_eq!(counts(shaped(0.51, off)), [1, 0, 0, 0]);
    let context = SelectionShape { context_after: 1, ..off };
    assert_eq!(counts(shaped(0.51, context)), [2, 0, 0, 0], "the rest of the shape holds");
    let best = Selection { rule: Rule::TopFraction(0.5), ..shaped(0.5, off) };
    assert_eq!(counts(best), [0, 0, 1, 0], "a fraction is one of all segments");
    let limited = SelectionShape { phases: 1, max_per_phase: 1, ..off };
    assert_eq!(counts(shaped(0.51, limited)), [1, 0, 0, 0], "what is left out takes no place of a limit");
}

#[test]
fn only_a_selection_by_cohorts_reads_their_rank() {
    assert!(shaped(0.5, SelectionShape::default()).reads_ranking());
    assert!(!shaped(0.0, SelectionShape { min_run: 5, ..SelectionShape::default() }).reads_ranking());
}
