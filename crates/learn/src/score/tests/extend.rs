//! Extending an earlier run gives the result of a full run.

use super::*;

/// The part of a run that the server stores.
fn base(scores: Scores, experts: &[Trajectory]) -> ScoreBase {
    let mut all = scores.imperfect;
    all.extend(scores.experts);
    all.iter_mut().for_each(|episode| episode.q.clear());
    let experts = experts.iter().map(|expert| expert.id.clone()).collect();
    ScoreBase { normaliser: scores.normaliser, experts, scores: all }
}

fn failures(count: u64) -> Vec<Trajectory> {
    (0..count).map(|i| toy::episode(&format!("failure {i}"), 100 + i, 7, i % 2 == 1)).collect()
}

fn try_extend(
    experts: &[Trajectory],
    imperfect: &[Trajectory],
    base: &ScoreBase,
    spec: &ScoreSpec,
) -> Result<Scores, LearnError> {
    let inputs = ScoreInputs { encoder: &encoder(), experts, imperfect, kept: &Forgetful };
    extend_scores(inputs, base, spec, &mut Silent)
}

fn extend(experts: &[Trajectory], imperfect: &[Trajectory], base: &ScoreBase, spec: &ScoreSpec) -> Scores {
    try_extend(experts, imperfect, base, spec).unwrap()
}

/// A full run under `normaliser`: it extends a run without scores.
fn full(experts: &[Trajectory], imperfect: &[Trajectory], normaliser: &Normaliser, spec: &ScoreSpec) -> Scores {
    let nothing = ScoreBase { normaliser: normaliser.clone(), experts: Vec::new(), scores: Vec::new() };
    let full = extend(experts, imperfect, &nothing, spec);
    let anew = run(experts, imperfect, spec);
    let w = |scores: &Scores| scores.imperfect.iter().map(|episode| episode.w.clone()).collect::<Vec<_>>();
    assert_eq!(w(&full), w(&anew));
    full
}

/// Every number's bits, with the matches.
fn bits(scores: &Scores) -> Vec<(u64, u32, u32, u32, [u32; 3])> {
    let episodes = scores.imperfect.iter().chain(&scores.experts);
    let segments = |e: &EpisodeScores| {
        let segment = |t: usize| {
            let distances = e.distances[t].map(f32::to_bits);
            (e.w[t].to_bits(), e.q[t].to_bits(), e.match_episode[t], e.match_step[t], distances)
        };
        (0..e.w.len()).map(segment).collect::<Vec<_>>()
    };
    episodes.flat_map(segments).collect()
}

#[test]
fn more_experts_more_imperfect_or_both_give_the_bits_of_a_full_run() {
    let (mut experts, imperfect) = (toy::experts(6, 8), failures(6));
    // New experts that tie with old ones: one before them in the order of ids, and one after.
    let twin = |of: &Trajectory, id: &str| Trajectory { id: id.into(), ..of.clone() };
    experts.insert(0, twin(&experts[1], "a twin"));
    experts.push(twin(&experts[2], "the twin"));
    let old: Vec<Trajectory> = experts[1..5].to_vec();
    for spec in some_specs() {
        let first = run(&old, &imperfect[..4], &spec);
        let base = base(first.clone(), &old);
        for (experts, imperfect) in [
            (old.as_slice(), &imperfect[..4]),
            (old.as_slice(), &imperfect[1..]),
            (experts.as_slice(), &imperfect[..4]),
            (experts.as_slice(), imperfect.as_slice()),
        ] {
            let extended = extend(experts, imperfect, &base, &spec);
            let full = full(experts, imperfect, &first.normaliser, &spec);
            assert_eq!(extended, full, "{spec:?}");
            assert_eq!(bits(&extended), bits(&full));
        }
    }
}

#[test]
fn a_lone_expert_and_an_episode_that_changed_its_role_are_scored_as_in_a_full_run() {
    let (experts, imperfect) = (toy::experts(2, 8), failures(3));
    let normaliser = NormaliserKind::Quantile;
    let spec = ScoreSpec { normaliser, ..spec_of("ssdf", &[("local_scale", false.into())]) };
    let first = run(&experts[..1], &imperfect, &spec);
    let base = base(first.clone(), &experts[..1]);
    // The last failure is relabelled as a success.
    let more = [imperfect[2].clone(), experts[0].clone()];
    for left in [&imperfect[..2], &imperfect] {
        let extended = extend(&more, left, &base, &spec);
        let full = full(&more, left, &first.normaliser, &spec);
        assert_eq!(extended, full);
        assert_eq!(extended.experts.len(), 2);
    }
    let extended = extend(&experts[..1], &imperfect, &base, &spec);
    assert_eq!(extended, first);
}

#[test]
fn a_run_with_one_expert_has_no_local_scale_and_is_not_extended() {
    let (experts, imperfect) = (toy::experts(2, 8), failures(2));
    let spec = minmax();
    let base = base(run(&experts[..1], &imperfect, &spec), &experts[..1]);
    let message = try_extend(&experts, &imperfect, &base, &spec).unwrap_err().to_string();
    assert!(message.starts_with("base.experts: ") && message.contains("score without extends"), "{message}");
}

#[test]
fn what_is_known_is_not_encoded_again() {
    let (experts, imperfect) = (toy::experts(3, 8), failures(4));
    let spec = ScoreSpec::default();
    let base = base(run(&experts, &imperfect, &spec), &experts);
    // Encoding this episode would change the scores.
    let mut blind = imperfect.clone();
    blind[0] = blind[0].changed(|arrays| arrays.proprioception.iter_mut().for_each(|value| *value += 3.0));
    let new = toy::episode("failure 9", 200, 7, false);
    blind.push(new);
    let extended = extend(&experts, &blind, &base, &spec);
    assert_eq!(extended.imperfect[0].w, base.scores[0].w);
    assert_ne!(extend(&toy::experts(4, 8), &blind, &base, &spec).imperfect[0].w, base.scores[0].w);
}

#[test]
fn a_base_that_does_not_fit_is_named() {
    let (experts, imperfect) = (toy::experts(3, 8), failures(2));
    let spec = ScoreSpec::default();
    let good = base(run(&experts, &imperfect, &spec), &experts);
    let message = |experts: &[Trajectory], base: &ScoreBase, spec: &ScoreSpec| {
        try_extend(experts, &imperfect, base, spec).unwrap_err().to_string()
    };
    let missing = message(&experts[1..], &good, &spec);
    assert!(missing.starts_with("base.experts: ") && missing.contains("expert 0"), "{missing}");
    let classifier = spec_of("classifier", &[]);
    assert!(message(&experts, &good, &classifier).starts_with("scorer: "));
    let with = |change: fn(&mut EpisodeScores)| {
        let mut base = good.clone();
        change(&mut base.scores[1]);
        message(&experts, &base, &spec)
    };
    for wrong in [
        with(|scores| scores.w.truncate(3)),
        with(|scores| scores.distances.clear()),
        with(|scores| scores.w[2] = f64::NAN),
        with(|scores| scores.match_episode[0] = 3),
        with(|scores| scores.match_step[0] = 8),
    ] {
        assert!(wrong.starts_with("base.scores: of episode failure 1 "), "{wrong}");
    }
    let normaliser = Normaliser { hi: f64::NAN, ..good.normaliser.clone() };
    assert!(message(&experts, &ScoreBase { normaliser, ..good.clone() }, &spec).starts_with("base.normaliser: "));
}

#[test]
fn kept_features_give_the_same_bits_and_are_not_encoded_again_without_need() {
    let (experts, mut imperfect) = (toy::experts(4, 8), failures(3));
    // So near to the first expert that no further one is nearer.
    imperfect[0] = Trajectory { id: imperfect[0].id.clone(), ..experts[0].clone() };
    for spec in specs() {
        let kept = Shared::default();
        let inputs = ScoreInputs { encoder: &encoder(), experts: &experts[..3], imperfect: &imperfect, kept: &kept };
        let first = score(inputs, &spec, &mut Silent).unwrap();
        assert_eq!(bits(&first), bits(&run(&experts[..3], &imperfect, &spec)));
        let of_all = kept.0.lock().unwrap().len();
        if spec.scorer.name == "raw" {
            assert_eq!(of_all, 0, "observations are not kept twice");
            continue;
        }
        assert_eq!(of_all, 6);
        // Encoding this episode would change the scores.
        let mut blind = imperfect.clone();
        blind[0] = blind[0].changed(|arrays| arrays.proprioception.iter_mut().for_each(|value| *value += 3.0));
        // Truncated, as by a disk fault: computed again.
        kept.0.lock().unwrap().get_mut("failure 1").unwrap().pop();
        let base = base(first.clone(), &experts[..3]);
        let inputs = ScoreInputs { experts: &experts, imperfect: &blind, ..inputs };
        let extended = extend_scores(inputs, &base, &spec, &mut Silent).unwrap();
        assert_eq!(bits(&extended), bits(&full(&experts, &imperfect, &first.normaliser, &spec)), "{spec:?}");
        assert_eq!(kept.0.lock().unwrap().len(), 7);
    }
}
