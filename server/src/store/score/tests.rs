//! Scores read back from a fresh database.

use super::*;
use crate::{
    domain::{episode::Outcome, job::JobState, snapshot::Role},
    error::Kind,
    store::testing::{self, results},
};

#[tokio::test]
async fn scores_round_trip() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    let expert = testing::episode(&store, &task, Outcome::Success, "").await;
    let failure = testing::episode(&store, &task, Outcome::Failure, "").await;
    let encoder = results::encoder(&store, &task).await;
    let mut scores = results::scores(&failure.id, Role::Imperfect, &[0.0, 1.0 / 3.0, 1.0]);
    scores.w = vec![-1.0 / 3.0, -0.0, f64::MIN_POSITIVE];
    scores.match_step = vec![u32::MAX, 0, 7];
    let all = [scores.clone(), results::scores(&expert.id, Role::Expert, &[0.5])];
    let run = results::run(&store, &task, &encoder, &all).await;

    assert_eq!(store.episode_scores(&run.id, &failure.id).await.unwrap(), scores);
    assert_eq!(store.episode_scores(&run.id, &expert.id).await.unwrap(), all[1]);
    let read = store.score_run(&run.id).await.unwrap();
    assert_eq!(read.expert_ids, [expert.id]);
    assert_eq!((&read.origin, &read.quantiles), (&run.origin, &run.quantiles));
    let counts = store.run_counts(&run).await.unwrap();
    let expected = RunCounts { imperfect_episodes: 1, imperfect_segments: 3, expert_segments: 20 };
    assert_eq!(counts, expected);
    let wrong = async || {
        let wrong = store.wrong_rows().await.unwrap();
        wrong.iter().any(|(id, detail)| id == run.id.as_str() && detail.contains("its counts are not those"))
    };
    assert!(!wrong().await);
    testing::run(&store, "update score_runs set imperfect_segments = 4").await;
    assert!(wrong().await);
    let segment_length = store.segment_length(Some(&encoder.id)).await.unwrap();
    assert_eq!(segment_length, gleaner_core::PretrainSpec::default().model.segment_length);
    let stranger = EpisodeId::new();
    assert_eq!(store.episode_scores(&run.id, &stranger).await.unwrap_err().kind(), Kind::NotFound);
}

#[tokio::test]
async fn a_missing_run_returns_its_cause() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    testing::episode(&store, &task, Outcome::Success, "").await;
    testing::episode(&store, &task, Outcome::Failure, "").await;
    let encoder = results::encoder(&store, &task).await;
    let (job, run) = results::scoring(&store, &task, &encoder).await;

    let error = store.score_run(&run).await.unwrap_err();
    assert_eq!(error.kind(), Kind::Precondition);
    assert!(error.message().contains(job.as_str()) && error.message().contains("queued"), "{error}");
    results::set_state(&store, &job, JobState::Failed, "no experts").await;
    let error = store.score_run(&run).await.unwrap_err();
    assert_eq!(error.kind(), Kind::Precondition);
    assert!(error.message().contains("no experts"), "{error}");
    let unknown = store.score_run(&ScoreRunId::new()).await.unwrap_err();
    assert_eq!(unknown.kind(), Kind::NotFound);
}

#[tokio::test]
async fn lists_of_different_length_are_rejected() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    testing::episode(&store, &task, Outcome::Success, "").await;
    let failure = testing::episode(&store, &task, Outcome::Failure, "").await;
    let encoder = results::encoder(&store, &task).await;
    let run = results::run(&store, &task, &encoder, &[]).await;
    let mut scores = results::scores(&failure.id, Role::Imperfect, &[0.5, 0.5]);
    scores.match_step.pop();
    let mut tx = store.write().await.unwrap();
    let error = insert_scores(&mut tx, &run.id, 0, &[scores]).await.unwrap_err();
    assert_eq!(error.kind(), Kind::Invalid);
}

#[tokio::test]
async fn scores_of_several_insertions_keep_their_order() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    testing::episode(&store, &task, Outcome::Success, "").await;
    let mut all = Vec::new();
    for steps in [BATCH_STEPS - 1, 1, 2, BATCH_STEPS, 3] {
        let episode = testing::episode(&store, &task, Outcome::Failure, "").await;
        all.push(results::scores(&episode.id, Role::Imperfect, &vec![0.5; steps]));
    }
    assert_eq!(batch_size(&all), 2);
    assert_eq!((batch_size(&all[2..]), batch_size(&all[4..])), (2, 1));
    let short = vec![results::scores(&EpisodeId::new(), Role::Imperfect, &[0.5]); BATCH_EPISODES + 1];
    assert_eq!(batch_size(&short), BATCH_EPISODES);

    let encoder = results::encoder(&store, &task).await;
    let run = results::run(&store, &task, &encoder, &all).await;
    let (mut read, mut behind) = (Vec::new(), -1);
    while let (some, Some(last)) = store.scores_behind(&run.id, behind, 2).await.unwrap() {
        assert!(some.len() <= 2);
        read.extend(some);
        behind = last;
    }
    assert!(read == all, "parts of two, in the snapshot's order");
    for scores in &all {
        assert!(store.episode_scores(&run.id, &scores.episode_id).await.unwrap() == *scores);
    }
}
