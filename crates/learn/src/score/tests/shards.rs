//! Score runs of two and three ranks, each on a thread of its own, beside the same run in one process.

use gleaner_core::ScoreSpec;

use super::*;
use crate::own_process::in_own_process;
use crate::peers::testing::ranks;
use crate::toy::{self, Recorder};
use crate::trajectory::Trajectory;

fn failures(count: u64) -> Vec<Trajectory> {
    let failure =
        |i| toy::episode(&format!("failure {i}"), 100 + i, 5 + 3 * usize::try_from(i % 4).unwrap(), i % 2 == 1);
    (0..count).map(failure).collect()
}

/// Each scorer that compares segments, with features of one step and of several, with and without the local scale.
fn specs() -> Vec<ScoreSpec> {
    let words = [("ssdf", "last_l2"), ("ssdf", "segment_cosine"), ("raw", "segment_l2"), ("raw", "last_cosine")];
    let of = |(scorer, similarity): (&str, &str), local: bool| {
        spec_of(scorer, &[("similarity", similarity.into()), ("local_scale", local.into())])
    };
    words.into_iter().flat_map(|words| [of(words, true), of(words, false)]).collect()
}

/// The scores of one process, or of rank 0 after checks on the reports of all.
fn shared(
    count: usize,
    (experts, imperfect): (&[Trajectory], &[Trajectory]),
    (base, kept): (Option<&ScoreBase>, &impl FeatureStore),
    spec: &ScoreSpec,
) -> Scores {
    let encoder = encoder();
    let mut all = ranks(&vec![None; count], |peers, monitor| {
        let mut alone = Peers::alone();
        let peers = if count == 1 { &mut alone } else { peers };
        score_with(ScoreInputs { encoder: &encoder, experts, imperfect, kept }, base, spec, (peers, monitor))
    });
    for (scores, monitor) in all.drain(1..) {
        assert!(scores.unwrap().is_none() && monitor.losses.is_empty());
    }
    let (scores, monitor) = all.remove(0);
    let total: usize = experts.iter().chain(experts).chain(imperfect).map(Trajectory::steps).sum();
    assert_eq!(monitor.losses.last().unwrap().0, total as u64, "progress ends with all segments of all ranks");
    assert!(monitor.losses.is_sorted());
    scores.unwrap().unwrap()
}

fn base_of(scores: Scores, experts: &[Trajectory]) -> ScoreBase {
    let mut all = [scores.imperfect, scores.experts].concat();
    all.iter_mut().for_each(|episode| episode.q.clear());
    ScoreBase {
        normaliser: scores.normaliser,
        experts: experts.iter().map(|expert| expert.id.clone()).collect(),
        scores: all,
    }
}

/// `assert_eq` would call −0 and 0 equal.
fn assert_same_bits(one: &Scores, other: &Scores, what: &str) {
    assert_eq!(one, other, "{what}");
    let bits = |scores: &Scores| -> Vec<(u64, u32, [u32; 3])> {
        let episodes = scores.imperfect.iter().chain(&scores.experts);
        let of = |episode: &crate::score::EpisodeScores, t: usize| {
            (episode.w[t].to_bits(), episode.q[t].to_bits(), episode.distances[t].map(f32::to_bits))
        };
        episodes.flat_map(|episode| (0..episode.w.len()).map(move |t| of(episode, t))).collect()
    };
    assert_eq!(bits(one), bits(other), "{what}");
}

#[test]
fn ranks_score_as_one_process_does_bit_for_bit() {
    if !in_own_process() {
        return;
    }
    let (experts, imperfect) = (toy::experts(4, 9), failures(7));
    for spec in specs() {
        // On one thread, as the ranks: a network's last bits depend on the number of threads.
        let alone = shared(1, (&experts, &imperfect), (None, &Forgetful), &spec);
        for count in [2, 3] {
            let scores = shared(count, (&experts, &imperfect), (None, &Forgetful), &spec);
            assert_same_bits(&scores, &alone, &format!("{count} ranks, {spec:?}"));
        }
    }
}

#[test]
fn ranks_extend_a_run_and_keep_features_as_one_process_does() {
    if !in_own_process() {
        return;
    }
    let (experts, imperfect) = (toy::experts(5, 8), failures(6));
    for spec in specs() {
        let run = |count: usize| {
            let kept = Shared::default();
            let first = shared(count, (&experts[..3], &imperfect[..4]), (None, &kept), &spec);
            let base = base_of(first.clone(), &experts[..3]);
            let unchanged = shared(count, (&experts[..3], &imperfect[..4]), (Some(&base), &kept), &spec);
            let extended = shared(count, (&experts, &imperfect), (Some(&base), &kept), &spec);
            ([first, unchanged, extended], kept.0.into_inner().unwrap())
        };
        let (alone, kept) = run(1);
        assert_eq!(kept.is_empty(), spec.scorer.name == "raw");
        let (scores, kept_by_three) = run(3);
        for (one, other) in scores.iter().zip(&alone) {
            assert_same_bits(one, other, &format!("{spec:?}"));
        }
        assert!(kept == kept_by_three, "{spec:?}: other features are kept");
    }
}

#[test]
fn more_ranks_than_episodes_and_a_lone_expert_are_scored() {
    if !in_own_process() {
        return;
    }
    let (experts, imperfect) = (toy::experts(1, 9), failures(1));
    let spec = minmax();
    let alone = score_anew(&experts, &imperfect, &spec, &mut Recorder::default()).unwrap();
    assert!(alone.experts.is_empty());
    assert_same_bits(&shared(3, (&experts, &imperfect), (None, &Forgetful), &spec), &alone, "a lone expert");
}

#[test]
fn an_error_in_the_part_of_one_rank_is_that_of_all() {
    if !in_own_process() {
        return;
    }
    let experts = toy::experts(1, 8);
    // Rank 1 meets the only expert, which is imperfect too.
    let imperfect = [failures(1), experts.clone()].concat();
    let (spec, encoder) = (minmax(), encoder());
    let inputs = || ScoreInputs { encoder: &encoder, experts: &experts, imperfect: &imperfect, kept: &Forgetful };
    let alone = score_anew(&experts, &imperfect, &spec, &mut Recorder::default()).unwrap_err().to_string();
    assert!(alone.starts_with("episode expert 0: is also the only expert"), "{alone}");
    let done = ranks(&[None; 3], |peers, monitor| score_with(inputs(), None, &spec, (peers, monitor)));
    for (scores, _) in done {
        assert_eq!(scores.unwrap_err().to_string(), alone);
    }
}

#[test]
fn a_rank_that_is_asked_to_stop_takes_all_along_and_a_lost_one_is_an_error() {
    if !in_own_process() {
        return;
    }
    let (experts, imperfect) = (toy::experts(3, 8), failures(4));
    let (spec, encoder) = (ScoreSpec::default(), encoder());
    let inputs = || ScoreInputs { encoder: &encoder, experts: &experts, imperfect: &imperfect, kept: &Forgetful };
    for stop_after in [[Some(1), None], [None, Some(0)]] {
        let done = ranks(&stop_after, |peers, monitor| score_with(inputs(), None, &spec, (peers, monitor)));
        assert!(done.iter().all(|(scores, _)| matches!(scores, Err(LearnError::Cancelled))), "{stop_after:?}");
    }
    let done = ranks(&[None, None], |peers, monitor| {
        // The group of rank 1 ends with it.
        if peers.lead() { score_with(inputs(), None, &spec, (peers, monitor)) } else { Ok(None) }
    });
    assert!(matches!(&done[0].0, Err(LearnError::Group(_))), "{:?}", done[0].0);
}

#[test]
fn a_scorer_that_needs_all_episodes_is_for_one_process() {
    if !in_own_process() {
        return;
    }
    let (experts, imperfect, encoder) = (toy::experts(3, 8), failures(3), encoder());
    let inputs = || ScoreInputs { encoder: &encoder, experts: &experts, imperfect: &imperfect, kept: &Forgetful };
    for scorer in ["vote", "progress", "deminf", "classifier", "random", "clock"] {
        let spec = spec_of(scorer, &[]);
        let done = ranks(&[None; 2], |peers, monitor| score_with(inputs(), None, &spec, (peers, monitor)));
        for (scores, _) in done {
            let message = scores.unwrap_err().to_string();
            assert!(message.starts_with(&format!("scorer: is {scorer}, whose every score")), "{message}");
            assert!(message.ends_with("score it in one process"), "{message}");
        }
    }
}
