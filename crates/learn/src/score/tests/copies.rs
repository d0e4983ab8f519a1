//! Experts with the same steps under several ids, as after a recording was pushed twice.

use super::*;
use gleaner_core::snapshot::Role;

/// Four experts, and the same again under other ids.
fn pushed_twice() -> (Vec<Trajectory>, Vec<Trajectory>) {
    let once = toy::experts(4, 9);
    let again = once.iter().map(|expert| Trajectory { id: format!("{} again", expert.id), ..expert.clone() });
    let twice = once.iter().cloned().chain(again).collect();
    (once, twice)
}

fn failures() -> Vec<Trajectory> {
    (0..3).map(|i| toy::episode(&format!("failure {i}"), 60 + i, 8, i == 1)).collect()
}

fn of_kind(normaliser: NormaliserKind, spec: ScoreSpec) -> ScoreSpec {
    ScoreSpec { normaliser, ..spec }
}

#[test]
fn experts_pushed_twice_give_the_scores_of_each_once() {
    let ((once, twice), imperfect) = (pushed_twice(), failures());
    for spec in some_specs() {
        let spec = of_kind(NormaliserKind::MinMax, without_lookahead(spec));
        let [expected, found] = [&once, &twice].map(|experts| run(experts, &imperfect, &spec));
        assert_eq!((&found.imperfect, &found.normaliser), (&expected.imperfect, &expected.normaliser), "{spec:?}");
        for (place, expert) in found.experts.iter().enumerate() {
            let original = &expected.experts[place % 4];
            assert_eq!(expert.episode_id, twice[place].id);
            assert_eq!((&expert.w, &expert.match_step), (&original.w, &original.match_step), "{spec:?}");
            assert_eq!((&expert.q, &expert.match_episode), (&original.q, &original.match_episode), "{spec:?}");
            assert!(expert.w.iter().all(|w| *w < 0.0), "a copy is no other expert: {spec:?}");
        }
    }
}

#[test]
fn experts_pushed_twice_calibrate_as_each_once() {
    let ((once, twice), imperfect) = (pushed_twice(), failures());
    for scorer in ["raw", "ssdf"] {
        let spec = of_kind(NormaliserKind::Calibrated, without_lookahead(spec_of(scorer, &[])));
        let [expected, found] = [&once, &twice].map(|experts| run(experts, &imperfect, &spec));
        for (found, expected) in found.imperfect.iter().zip(&expected.imperfect) {
            // Shares of 36 segments, and of 72.
            let near = found.q.iter().zip(&expected.q).all(|(found, expected)| (found - expected).abs() < 0.1);
            assert!(near, "{scorer}: {:?} {:?}", found.q, expected.q);
        }
    }
}

#[test]
fn copies_of_one_recording_are_one_expert() {
    let ((once, twice), imperfect) = (pushed_twice(), failures());
    let copies = [twice[0].clone(), twice[4].clone()];
    let calibrated = of_kind(NormaliserKind::Calibrated, ScoreSpec::default());
    let message = score_anew(&copies, &imperfect, &calibrated, &mut Silent).unwrap_err().to_string();
    assert!(message.starts_with("experts: are copies of one recording, but calibrated "), "{message}");
    let alone = run(&copies, &imperfect, &minmax());
    assert_eq!(alone, run(&once[..1], &imperfect, &minmax()));
    let base = ScoreBase {
        normaliser: alone.normaliser,
        experts: copies.iter().map(|expert| expert.id.clone()).collect(),
        scores: alone.imperfect,
    };
    let inputs = ScoreInputs { encoder: &encoder(), experts: &twice, imperfect: &imperfect, kept: &Forgetful };
    let message = extend_scores(inputs, &base, &minmax(), &mut Silent).unwrap_err().to_string();
    assert!(message.starts_with("base.experts: are copies of one recording"), "{message}");
}

#[test]
fn a_run_that_matched_copies_with_each_other_is_not_extended() {
    let ((_, twice), imperfect) = (pushed_twice(), failures());
    let spec = spec_of("raw", &[]);
    let first = run(&twice, &imperfect, &spec);
    let mut scores = [first.imperfect.clone(), first.experts.clone()].concat();
    for (place, expert) in (0u32..).zip(scores.iter_mut().filter(|episode| episode.role == Role::Expert)) {
        let steps = expert.w.len();
        expert.w = vec![0.0; steps];
        expert.match_episode = vec![(place + 4) % 8; steps];
        expert.match_step = (0..).take(steps).collect();
        expert.distances = vec![[0.0; 3]; steps];
    }
    let experts = twice.iter().map(|expert| expert.id.clone()).collect();
    let base = ScoreBase { normaliser: first.normaliser.clone(), experts, scores };
    let inputs = ScoreInputs { encoder: &encoder(), experts: &twice, imperfect: &imperfect, kept: &Forgetful };
    let message = extend_scores(inputs, &base, &spec, &mut Silent).unwrap_err().to_string();
    assert!(message.starts_with("base.scores: match an expert with a copy of itself"), "{message}");
    let scores = [first.imperfect.clone(), first.experts.clone()].concat();
    assert_eq!(extend_scores(inputs, &ScoreBase { scores, ..base }, &spec, &mut Silent).unwrap(), first);
}

#[test]
fn a_copy_that_became_an_expert_is_compared_with_other_recordings() {
    let (mut experts, mut imperfect) = (toy::experts(4, 9), failures());
    let copy = Trajectory { id: "lucky".into(), ..experts[1].clone() };
    imperfect.push(copy.clone());
    for spec in some_specs() {
        let first = run(&experts, &imperfect, &spec);
        assert_eq!(first.imperfect[3].w, vec![0.0; 9], "{spec:?}");
        let ids = experts.iter().map(|expert| expert.id.clone()).collect();
        let scores = [first.imperfect, first.experts].concat();
        let base = ScoreBase { normaliser: first.normaliser, experts: ids, scores };
        experts.push(copy.clone());
        let inputs =
            ScoreInputs { encoder: &encoder(), experts: &experts, imperfect: &imperfect[..3], kept: &Forgetful };
        let extended = extend_scores(inputs, &base, &spec, &mut Silent).unwrap();
        let nothing = ScoreBase { experts: Vec::new(), scores: Vec::new(), ..base };
        assert_eq!(extended, extend_scores(inputs, &nothing, &spec, &mut Silent).unwrap(), "{spec:?}");
        assert_eq!(extended.experts[4].w, extended.experts[1].w);
        experts.pop();
    }
}

#[test]
fn a_live_scorer_counts_a_recording_once_too() {
    let ((_, twice), imperfect) = (pushed_twice(), failures());
    for scorer in ["raw", "ssdf"] {
        let spec = spec_of(scorer, &[]);
        let scores = run(&twice, &imperfect, &spec);
        let live = LiveScorer::load(&encoder(), &twice, &spec, scores.normaliser.clone()).unwrap();
        assert_eq!(live.score_episode(&imperfect[0]).unwrap(), scores.imperfect[0], "{scorer}");
        let expert = live.score_episode(&Trajectory { id: "recording".into(), ..twice[6].clone() }).unwrap();
        assert_eq!(expert, scores.experts[2], "{scorer}");
    }
}
