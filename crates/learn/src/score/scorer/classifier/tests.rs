//! The data that the classifier learns from, and the data it must not depend on.

use crate::LearnError;
use crate::score::Scores;
use crate::score::tests::{score_anew, spec_of};
use crate::toy;
use crate::train::Silent;
use crate::trajectory::Trajectory;

fn failures(count: u64) -> Vec<Trajectory> {
    (0..count).map(|i| toy::episode(&format!("failure {i}"), 100 + i, 9, false)).collect()
}

fn classify(experts: &[Trajectory], imperfect: &[Trajectory], seed: u64) -> Result<Scores, LearnError> {
    let spec = spec_of("classifier", &[("seed", seed.into())]);
    score_anew(experts, imperfect, &spec, &mut Silent)
}

#[test]
fn experts_are_separated_from_unseen_failures_and_nothing_is_matched() {
    let (experts, imperfect) = (toy::experts(8, 9), failures(8));
    let scores = classify(&experts, &imperfect, 1).unwrap();
    let mean = |scores: &[crate::EpisodeScores]| {
        let all: Vec<f64> = scores.iter().flat_map(|episode| episode.w.clone()).collect();
        all.iter().sum::<f64>() / f64::from(u32::try_from(all.len()).unwrap())
    };
    assert!(mean(&scores.experts) > mean(&scores.imperfect) + 0.5);
    for (episode, given) in scores.imperfect.iter().zip(&imperfect) {
        assert_eq!((&episode.episode_id, episode.w.len(), episode.q.len()), (&given.id, 9, 9));
        assert!(episode.w.iter().all(|w| *w <= 0.0));
        assert!(episode.match_episode.is_empty() && episode.match_step.is_empty() && episode.distances.is_empty());
    }
}

#[test]
fn an_episode_is_not_scored_by_a_network_that_saw_it() {
    let (experts, mut imperfect) = (toy::experts(4, 6), failures(4));
    let before = classify(&experts, &imperfect, 3).unwrap();
    // Another recording under the first id changes the network that scores the other fold, and does not change the one
    // that scores its own fold.
    imperfect[0] = toy::episode("failure 0", 999, 9, false);
    let after = classify(&experts, &imperfect, 3).unwrap();
    assert_eq!(before.imperfect[2].w, after.imperfect[2].w);
    assert_ne!(before.imperfect[1].w, after.imperfect[1].w);
}

#[test]
fn a_copy_is_not_scored_by_a_network_that_saw_its_original() {
    let (experts, mut imperfect) = (toy::experts(4, 9), failures(4));
    // In the order of ids each would be in the other fold than its original.
    imperfect.push(Trajectory { id: "failure 0 again".into(), ..imperfect[0].clone() });
    imperfect.push(Trajectory { id: "failure 9".into(), ..experts[1].clone() });
    let scores = classify(&experts, &imperfect, 3).unwrap();
    assert_eq!(scores.imperfect[4].w, scores.imperfect[0].w);
    assert_eq!(scores.imperfect[5].w, scores.experts[1].w);
    let copies = [experts[0].clone(), Trajectory { id: "expert 0 again".into(), ..experts[0].clone() }];
    let message = classify(&copies, &imperfect, 3).unwrap_err().to_string();
    assert!(message.starts_with("experts: has too few different episodes"), "{message}");
}

#[test]
fn too_few_episodes_for_two_folds_are_refused() {
    let message = classify(&toy::experts(1, 6), &failures(4), 1).unwrap_err().to_string();
    assert!(message.starts_with("experts: "), "{message}");
    let message = classify(&toy::experts(4, 6), &failures(1), 1).unwrap_err().to_string();
    assert!(message.starts_with("imperfect: "), "{message}");
}
