//! Datasets in a fresh database.

use super::*;
use crate::{
    domain::{episode::Outcome, job::JobState, selection::SelectionShape, snapshot::Role},
    error::Kind,
    store::testing::{self, results},
};

#[tokio::test]
async fn contents_are_the_experts_and_segments_above_beta() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    let expert = testing::episode(&store, &task, Outcome::Success, "").await;
    let good = testing::episode(&store, &task, Outcome::Failure, "").await;
    let bad = testing::episode(&store, &task, Outcome::Failure, "").await;
    let encoder = results::encoder(&store, &task).await;
    let scores = [
        results::scores(&good.id, Role::Imperfect, &[0.95, 0.9, 0.2, 1.0]),
        results::scores(&bad.id, Role::Imperfect, &[0.9, 0.0]),
    ];
    let run = results::run(&store, &task, &encoder, &scores).await;
    let dataset = store.insert_dataset(&run.id, Selection::beta(0.9)).await.unwrap();

    let contents = store.dataset_contents(&dataset.id).await.unwrap();
    assert_eq!(contents.experts, std::slice::from_ref(&expert.id));
    assert_eq!((&contents.snapshot_id, &contents.run.origin), (&encoder.snapshot_id, &run.origin));
    let segments = [(0, 0.95), (3, 1.0)].map(|(end_step, weight)| WeightedSegment { end_step, weight });
    // A stream of segments holds those of the whole dataset.
    assert_eq!(size_of_val(&contents.kept[0].segments[0]), 8);
    assert_eq!(contents.kept, [KeptEpisode { episode_id: good.id, segments: segments.to_vec() }]);

    // Those of a job have their matches too, if it reads them.
    for (detail, matched) in [(KeptDetail::Weights, false), (KeptDetail::Scores, true)] {
        let (out, mut sent) = mpsc::channel(2);
        store.send_kept((&contents.run, dataset.selection), detail, &out).await.unwrap();
        let nearest = |end_step| matched.then(|| Nearest { episode_id: expert.id.clone(), end_step });
        let with_match = |WeightedSegment { end_step, weight }| {
            let nearest = nearest(end_step);
            KeptSegment { end_step, weight, nearest }
        };
        assert_eq!(sent.recv().await.unwrap().segments, segments.map(with_match), "{detail:?}");
    }
}

#[tokio::test]
async fn contents_wait_for_the_run() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    testing::episode(&store, &task, Outcome::Success, "").await;
    let failure = testing::episode(&store, &task, Outcome::Failure, "").await;
    let encoder = results::encoder(&store, &task).await;
    let (job, unfinished) = results::scoring(&store, &task, &encoder).await;
    let early = store.insert_dataset(&unfinished, Selection::beta(0.5)).await.unwrap();
    let scores = [results::scores(&failure.id, Role::Imperfect, &[0.6, 0.3])];
    let run = results::run(&store, &task, &encoder, &scores).await;
    let later = store.insert_dataset(&run.id, Selection::beta(0.5)).await.unwrap();
    store.insert_dataset(&run.id, Selection::beta(0.0)).await.unwrap();

    let datasets = store.datasets(&task.id).await.unwrap();
    assert_eq!((datasets.len(), &datasets[2].id), (3, &early.id), "newest first");
    assert_eq!(store.dataset_counts(&later.id).await.unwrap(), None, "not counted yet");
    let kept = Kept { segments: 1, of_segments: 2, episodes: 1, of_episodes: 1 };
    for dataset in [&early, &later] {
        store.keep_counts(&dataset.id, kept).await.unwrap();
    }
    let counts = DatasetCounts { kept_segments: 1, kept_episodes: 1, expert_segments: 20 };
    assert_eq!(store.dataset_counts(&later.id).await.unwrap(), Some(counts));
    assert_eq!(store.dataset_counts(&early.id).await.unwrap(), None, "its run is not finished");

    let error = store.dataset_contents(&early.id).await.unwrap_err();
    assert_eq!(error.kind(), Kind::Precondition);
    results::set_state(&store, &job, JobState::Cancelled, "").await;
    assert_eq!(store.insert_dataset(&unfinished, Selection::beta(0.5)).await.unwrap_err().kind(), Kind::Precondition);
    assert_eq!(
        store.insert_dataset(&ScoreRunId::new(), Selection::beta(0.5)).await.unwrap_err().kind(),
        Kind::NotFound
    );
}

#[tokio::test]
async fn a_top_fraction_keeps_the_best_and_the_same_one_twice_is_one() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    testing::episode(&store, &task, Outcome::Success, "").await;
    let good = testing::episode(&store, &task, Outcome::Failure, "").await;
    let bad = testing::episode(&store, &task, Outcome::Failure, "").await;
    let encoder = results::encoder(&store, &task).await;
    let mut unmatched = results::scores(&bad.id, Role::Imperfect, &[0.6, 0.0]);
    (unmatched.match_episode, unmatched.match_step, unmatched.distances) = Default::default();
    let scores = [results::scores(&good.id, Role::Imperfect, &[0.95, 0.6, 0.2, 1.0]), unmatched];
    let run = results::run(&store, &task, &encoder, &scores).await;

    let dataset = store.insert_dataset(&run.id, Selection::top_fraction(0.5)).await.unwrap();
    let contents = store.dataset_contents(&dataset.id).await.unwrap();
    let ends = |kept: &KeptEpisode| kept.segments.iter().map(|segment| segment.end_step).collect::<Vec<_>>();
    let kept: Vec<_> = contents.kept.iter().map(|kept| (&kept.episode_id, ends(kept))).collect();
    assert_eq!(kept, [(&good.id, vec![0, 1, 3]), (&bad.id, vec![0])], "the third highest w occurs twice");
    let (out, mut sent) = mpsc::channel(3);
    store.send_kept((&contents.run, dataset.selection), KeptDetail::Scores, &out).await.unwrap();
    let matched =
        [sent.recv().await.unwrap(), sent.recv().await.unwrap()].map(|kept| kept.segments[0].nearest.is_some());
    assert_eq!(matched, [true, false], "the other scorer matches nothing");

    let again = store.insert_dataset(&run.id, Selection::top_fraction(0.5)).await.unwrap();
    let other = store.insert_dataset(&run.id, Selection::beta(0.5)).await.unwrap();
    assert_eq!((again.id, again.selection), (dataset.id.clone(), dataset.selection));
    assert_ne!(other.id, dataset.id);
}

#[tokio::test]
async fn a_shape_is_stored_and_contents_and_equality_follow_it() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    // 20 steps, so that step 10 is the first of its second half.
    testing::episode(&store, &task, Outcome::Success, "").await;
    let one = testing::episode(&store, &task, Outcome::Failure, "").await;
    let other = testing::episode(&store, &task, Outcome::Failure, "").await;
    let encoder = results::encoder(&store, &task).await;
    let mut late = results::scores(&one.id, Role::Imperfect, &[0.9, 0.2, 0.8, 0.1, 0.7]);
    late.match_step = vec![9, 10, 10, 11, 11];
    let mut unmatched = results::scores(&other.id, Role::Imperfect, &[0.6, 0.95, 0.0, 0.85]);
    (unmatched.match_episode, unmatched.match_step, unmatched.distances) = Default::default();
    let run = results::run(&store, &task, &encoder, &[late, unmatched]).await;

    let plain = Selection::beta(0.5);
    let shaped = |shape| Selection { shape, ..plain };
    let off = SelectionShape::default();
    let gaps = shaped(SelectionShape { close_gaps: 1, min_run: 4, ..off });
    let halves = shaped(SelectionShape { phases: 2, max_per_phase: 2, ..off });
    let best = Selection { rule: Rule::TopFraction(0.3), shape: SelectionShape { context_before: 1, ..off } };
    let mut datasets = Vec::new();
    for (selection, kept) in [
        (plain, vec![vec![0, 2, 4], vec![0, 1, 3]]),
        (gaps, vec![vec![0, 1, 2, 3, 4], vec![0, 1, 2, 3]]),
        (halves, vec![vec![0, 2], vec![1, 3]]),
        (best, vec![vec![0], vec![0, 1, 2, 3]]),
    ] {
        let dataset = store.insert_dataset(&run.id, selection).await.unwrap();
        assert_eq!(store.dataset(&dataset.id).await.unwrap().selection, selection);
        assert_eq!(store.insert_dataset(&run.id, selection).await.unwrap().id, dataset.id, "the same twice is one");
        let contents = store.dataset_contents(&dataset.id).await.unwrap();
        let ends = |kept: &KeptEpisode| kept.segments.iter().map(|segment| segment.end_step).collect::<Vec<_>>();
        assert_eq!(contents.kept.iter().map(ends).collect::<Vec<_>>(), kept, "{selection:?}");
        datasets.push(dataset);
    }
    let ids: std::collections::BTreeSet<_> = datasets.iter().map(|dataset| dataset.id.clone()).collect();
    assert_eq!(ids.len(), 4, "each shape is another dataset");
    let weights = &store.dataset_contents(&datasets[1].id).await.unwrap().kept[0].segments;
    assert_eq!(
        weights.iter().map(|segment| segment.weight).collect::<Vec<_>>(),
        [0.9, 0.2, 0.8, 0.1, 0.7],
        "their own q"
    );
}

#[tokio::test]
async fn cohorts_that_rank_above_experts_are_left_out_of_contents_and_jobs() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    let expert = testing::episode(&store, &task, Outcome::Success, "").await;
    let dropped = testing::episode(&store, &task, Outcome::Failure, "dropped").await;
    let wrong = testing::episode(&store, &task, Outcome::Failure, "wrong").await;
    let encoder = results::encoder(&store, &task).await;
    let scores = [
        results::scores(&expert.id, Role::Expert, &[0.8, 0.8]),
        results::scores(&dropped.id, Role::Imperfect, &[0.7, 0.1]),
        results::scores(&wrong.id, Role::Imperfect, &[0.9, 0.7, 0.95]),
    ];
    let run = results::run(&store, &task, &encoder, &scores).await;
    let shape = SelectionShape { min_expert_auroc: 0.5, ..SelectionShape::default() };
    for (selection, kept) in [
        (Selection::beta(0.5), vec![&dropped.id, &wrong.id]),
        (Selection { shape, ..Selection::beta(0.5) }, vec![&dropped.id]),
        (Selection { shape, ..Selection::top_fraction(1.0) }, vec![&dropped.id]),
    ] {
        let dataset = store.insert_dataset(&run.id, selection).await.unwrap();
        assert_eq!(store.dataset(&dataset.id).await.unwrap().selection, selection);
        let contents = store.dataset_contents(&dataset.id).await.unwrap();
        let episodes: Vec<_> = contents.kept.iter().map(|kept| &kept.episode_id).collect();
        assert_eq!(episodes, kept, "{selection:?}");
        let (out, mut sent) = mpsc::channel(3);
        store.send_kept((&contents.run, selection), KeptDetail::Weights, &out).await.unwrap();
        drop(out);
        let mut episodes = Vec::new();
        while let Some(input) = sent.recv().await {
            episodes.push(input.episode.id);
        }
        assert_eq!(episodes.iter().collect::<Vec<_>>(), kept, "{selection:?}");
    }
}
