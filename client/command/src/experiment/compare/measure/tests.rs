//! Measures on a few episodes, computed by hand.

use super::*;
use crate::quality::Mark;
use gleaner_core::id::EpisodeId;

/// Four imperfect episodes of two lengths (cohort, outcome, first wrong step, q) and two experts.
const IMPERFECT: [(&str, &str, Option<u32>, &[f32]); 4] = [
    ("freeze", "failure", Some(2), &[0.9, 0.8, 0.1, 0.2]),
    ("freeze", "failure", Some(0), &[0.3, 0.4, 0.1, 0.0]),
    ("noise", "success", None, &[0.7, 0.6]),
    ("noise", "failure", Some(1), &[0.5, 0.65]),
];

fn known(cohort: &str, outcome: &str, steps: u64, mark: Option<Mark>) -> Known {
    Known { id: cohort.into(), cohort: cohort.into(), outcome: outcome.into(), steps, mark }
}

fn episodes(marked: bool) -> Episodes {
    let imperfect = IMPERFECT.map(|(cohort, outcome, went_wrong, q)| {
        known(cohort, outcome, q.len() as u64, marked.then_some(Mark { went_right: None, went_wrong }))
    });
    let experts = [3, 5, 9].map(|steps| known("expert", "success", steps, None));
    Episodes::new(imperfect.into(), experts.into(), 2)
}

fn run(id: &str, change: impl Fn(f32) -> f32) -> Run {
    let episode = |(cohort, outcome, went_wrong, q): (&str, &str, Option<u32>, &[f32])| MarkedEpisode {
        scores: Candidate {
            episode_id: EpisodeId::new(),
            cohort: cohort.into(),
            q: q.iter().map(|q| change(*q)).collect(),
            w: q.iter().map(|q| f64::from(*q)).collect(),
            places: Vec::new(),
        },
        success: outcome == "success",
        mark: Mark { went_right: None, went_wrong },
    };
    let experts = vec![Some(0.9), Some(0.8), Some(0.7)];
    Run { id: id.into(), imperfect: IMPERFECT.map(episode).into(), experts }
}

fn near(found: Option<f64>, expected: f64) {
    assert!(found.is_some_and(|found| (found - expected).abs() < 1e-9), "{found:?}, expected {expected}");
}

#[test]
fn auroc_at_equal_length_counts_pairs_of_equal_length_only() {
    let (episodes, run) = (episodes(true), run("a", |q| q));
    assert_eq!(episodes.bins, [1, 1, 0, 0]);
    let found = separated(&episodes, &[&run]);
    let [all, failures, freeze, noise] = &found.marked[..] else { panic!("{found:?}") };
    // Good .9 .8 | .7 .6 .5; bad .1 .2 .3 .4 .1 .0 | .65: the long ones win 12 of 12, the short ones 1 of 3.
    assert_eq!((all.pooled.cohort.as_str(), all.pairs), ("all", 15));
    near(all.equal_length, 13.0 / 15.0);
    // Over all pairs: .9 .8 .7 win 7 each, .6 and .5 win 6 each.
    near(Some(all.pooled.mean), 33.0 / 35.0);
    assert_eq!((failures.pooled.cohort.as_str(), failures.pairs), ("failures only", 13));
    near(failures.equal_length, 12.0 / 13.0);
    assert_eq!((freeze.pooled.cohort.as_str(), freeze.pairs, freeze.equal_length), ("freeze", 12, Some(1.0)));
    assert_eq!((noise.pooled.cohort.as_str(), noise.pairs), ("noise", 3));
    near(noise.equal_length, 1.0 / 3.0);
}

#[test]
fn auroc_at_equal_step_counts_pairs_of_the_same_step_only() {
    let (episodes, run) = (episodes(true), run("a", |q| q));
    let all = |run: &Run| separated(&episodes, &[run]).marked[0].clone();
    // Step 0: good .9 .7 .5 against bad .3; step 1: good .8 .6 against bad .4 .65; later steps are all bad.
    let by_q = all(&run);
    assert_eq!(by_q.step_pairs, 3 + 4);
    near(by_q.equal_step, (3.0 + 3.0) / 7.0);
    let by_step = all(&by_step(&run));
    // The first steps win against every later bad one, and half against the one beside them: 3 · 6.5 of 35, and 2 · 5.
    near(Some(by_step.pooled.mean), (3.0 * 6.5 + 2.0 * 5.0) / 35.0);
    assert_eq!((by_step.equal_step, by_step.step_pairs), (Some(0.5), 7), "the step separates no segments of one step");
    let outcome = separated(&episodes, &[&run]).outcome.unwrap();
    assert_eq!((outcome.equal_step, outcome.step_pairs), (None, 0), "episodes have no step");
}

#[test]
fn outcomes_separate_episodes_by_their_mean() {
    let found = separated(&episodes(false), &[&run("a", |q| q)]);
    assert!(found.marked.is_empty(), "no episode is marked");
    let outcome = found.outcome.unwrap();
    // The success has mean 0.65, the failures 0.5, 0.2 and 0.575; only the last one has its length.
    assert_eq!((outcome.pooled.mean, outcome.equal_length, outcome.pairs), (1.0, Some(1.0), 1));
    let length = separated(&episodes(false), &[&by_length(&run("a", |q| q))]).outcome.unwrap();
    near(Some(length.pooled.mean), 2.5 / 3.0);
    assert_eq!(length.equal_length, Some(0.5), "length separates no episodes of equal length");
}

#[test]
fn length_correlates_within_each_group() {
    let found = length(&episodes(true), &[&run("a", |q| q), &run("b", |q| 1.0 - q)]);
    let groups: Vec<(&str, usize)> = found.iter().map(|row| (row.group.as_str(), row.episodes)).collect();
    let expected = [("imperfect", 4), ("imperfect, failure", 3), ("imperfect, success", 1), ("experts", 3)];
    assert_eq!(groups, expected);
    near(found[0].spearman, 0.0);
    assert_eq!(found[2].spearman, None, "one episode has no correlation");
    near(found[3].spearman, -1.0);
    // Lengths 4, 4, 2, 2: ranks 3.5 3.5 1.5 1.5; means .5, .2, .65, .575: ranks 2 1 4 3: −4 / √(4 · 5).
    near(length(&episodes(true), &[&run("a", |q| q)])[0].spearman, -4.0 / 20.0_f64.sqrt());
}

#[test]
fn the_best_part_is_the_one_that_the_server_keeps() {
    let best = run("a", |_| 0.5).best(0.25);
    // All q are equal, so w decides: the three highest of twelve are .9, .8 and .7.
    let kept: Vec<usize> = best.iter().enumerate().filter(|(_, kept)| **kept).map(|(place, _)| place).collect();
    assert_eq!(kept, [0, 1, 8]);
}

#[test]
fn agreement_is_the_mean_over_seeds_and_stability_over_runs() {
    let runs = [run("a", |q| q), run("b", |q| 1.0 - q), run("c", |q| q * q)];
    let rankings: Vec<Ranking> = runs.iter().map(|run| Ranking::new(run, 0.25)).collect();
    let [a, b, c] = [0, 1, 2].map(|place| Some(&rankings[place]));
    // a and b are opposite and share no best segment; a and c order alike.
    let (correlation, overlap) = agreement(&[a, a, a], &[b, c, b]);
    near(correlation, 0.0);
    near(overlap, 0.5);
    assert_eq!(agreement(&[a, None], &[None, c]), (None, None));
    near(stability(&[&rankings[0], &rankings[2]]), 1.0);
    near(stability(&[&rankings[0], &rankings[1], &rankings[2]]), (-1.0 + 1.0 - 1.0) / 3.0);
    assert_eq!(stability(&[&rankings[0]]), None);
}
