//! Datasets in a fresh database.

use super::*;
use crate::{
    domain::{episode::Outcome, job::JobState, snapshot::Role},
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
    let dataset = store.insert_dataset(&run.id, Selection::Beta(0.9)).await.unwrap();

    let contents = store.dataset_contents(&dataset.id).await.unwrap();
    assert_eq!(contents.experts, std::slice::from_ref(&expert.id));
    assert_eq!((contents.snapshot_id, contents.encoder_id), (encoder.snapshot_id, encoder.id));
    let segment = |end_step, weight| {
        let nearest = Some(Nearest { episode_id: expert.id.clone(), end_step });
        KeptSegment { end_step, weight, nearest }
    };
    let segments = vec![segment(0, 0.95), segment(3, 1.0)];
    assert_eq!(contents.kept, [KeptEpisode { episode_id: good.id, segments }]);
}

#[tokio::test]
async fn counts_agree_with_contents_and_wait_for_the_run() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    testing::episode(&store, &task, Outcome::Success, "").await;
    let failure = testing::episode(&store, &task, Outcome::Failure, "").await;
    let encoder = results::encoder(&store, &task).await;
    let (job, unfinished) = results::scoring(&store, &task, &encoder).await;
    let early = store.insert_dataset(&unfinished, Selection::Beta(0.5)).await.unwrap();
    let scores = [results::scores(&failure.id, Role::Imperfect, &[0.6, 0.3])];
    let run = results::run(&store, &task, &encoder, &scores).await;
    store.insert_dataset(&run.id, Selection::Beta(0.5)).await.unwrap();
    store.insert_dataset(&run.id, Selection::Beta(0.0)).await.unwrap();

    let datasets = store.datasets(&task.id).await.unwrap();
    let counts = store.dataset_counts(&datasets).await.unwrap();
    let some = |kept_segments| Some(DatasetCounts { kept_segments, kept_episodes: 1, expert_segments: 20 });
    assert_eq!(counts, [some(2), some(1), None], "newest first");

    let error = store.dataset_contents(&early.id).await.unwrap_err();
    assert_eq!(error.kind(), Kind::Precondition);
    results::set_state(&store, &job, JobState::Cancelled, "").await;
    assert_eq!(store.insert_dataset(&unfinished, Selection::Beta(0.5)).await.unwrap_err().kind(), Kind::Precondition);
    assert_eq!(
        store.insert_dataset(&ScoreRunId::new(), Selection::Beta(0.5)).await.unwrap_err().kind(),
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

    let dataset = store.insert_dataset(&run.id, Selection::TopFraction(0.5)).await.unwrap();
    let contents = store.dataset_contents(&dataset.id).await.unwrap();
    let ends = |kept: &KeptEpisode| kept.segments.iter().map(|segment| segment.end_step).collect::<Vec<_>>();
    let kept: Vec<_> = contents.kept.iter().map(|kept| (&kept.episode_id, ends(kept))).collect();
    assert_eq!(kept, [(&good.id, vec![0, 1, 3]), (&bad.id, vec![0])], "the third highest w occurs twice");
    assert_eq!(contents.kept[1].segments[0].nearest, None);

    let again = store.insert_dataset(&run.id, Selection::TopFraction(0.5)).await.unwrap();
    let other = store.insert_dataset(&run.id, Selection::Beta(0.5)).await.unwrap();
    assert_eq!((again.id, again.selection), (dataset.id.clone(), dataset.selection));
    assert_ne!(other.id, dataset.id);
    let counts = store.dataset_counts(&[other, dataset]).await.unwrap();
    let some = |kept_segments| Some(DatasetCounts { kept_segments, kept_episodes: 2, expert_segments: 20 });
    assert_eq!(counts, [some(4), some(4)]);
}
