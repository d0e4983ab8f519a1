//! Datasets and exports in a fresh database.

#![allow(clippy::unwrap_used)]
use super::*;
use crate::{
    domain::{
        episode::Outcome,
        job::{JobSpec, JobState},
        snapshot::Role,
    },
    error::Kind,
    store::testing::{self, results},
};

#[tokio::test]
async fn contents_are_the_experts_and_what_lies_above_beta() {
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
    let dataset = store.insert_dataset(&run.id, 0.9).await.unwrap();

    let contents = store.dataset_contents(&dataset.id).await.unwrap();
    assert_eq!(contents.experts, std::slice::from_ref(&expert.id));
    assert_eq!((contents.snapshot_id, contents.encoder_id), (encoder.snapshot_id, encoder.id));
    let segment =
        |end_step, weight| KeptSegment { end_step, weight, match_episode: expert.id.clone(), match_step: end_step };
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
    let early = store.insert_dataset(&unfinished, 0.5).await.unwrap();
    let scores = [results::scores(&failure.id, Role::Imperfect, &[0.6, 0.3])];
    let run = results::run(&store, &task, &encoder, &scores).await;
    store.insert_dataset(&run.id, 0.5).await.unwrap();
    store.insert_dataset(&run.id, 0.0).await.unwrap();

    let datasets = store.datasets(&task.id).await.unwrap();
    let counts = store.dataset_counts(&datasets).await.unwrap();
    let some = |kept_segments| Some(DatasetCounts { kept_segments, kept_episodes: 1, expert_segments: 20 });
    assert_eq!(counts, [some(2), some(1), None], "newest first");

    let error = store.dataset_contents(&early.id).await.unwrap_err();
    assert_eq!(error.kind(), Kind::Precondition);
    results::set_state(&store, &job, JobState::Cancelled, "").await;
    assert_eq!(store.insert_dataset(&unfinished, 0.5).await.unwrap_err().kind(), Kind::Precondition);
    assert_eq!(store.insert_dataset(&ScoreRunId::new(), 0.5).await.unwrap_err().kind(), Kind::NotFound);
}

#[tokio::test]
async fn files_of_an_export_keep_their_order() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    testing::episode(&store, &task, Outcome::Success, "").await;
    testing::episode(&store, &task, Outcome::Failure, "").await;
    let encoder = results::encoder(&store, &task).await;
    let run = results::run(&store, &task, &encoder, &[]).await;
    let dataset = store.insert_dataset(&run.id, 0.9).await.unwrap();
    let export = ExportId::new();
    let spec = JobSpec::Export { dataset_id: dataset.id.clone() };
    let job = results::job(&store, &task, spec, export.as_str()).await;
    assert_eq!(store.export_files(&export).await.unwrap_err().kind(), Kind::Precondition);

    let file = |name: &str| ExportFile { name: name.into(), blob: blake3::hash(name.as_bytes()).into(), size_bytes: 3 };
    let files = [file("z.mcap"), file("manifest.jsonl")];
    let mut tx = store.write().await.unwrap();
    insert_export(&mut tx, &export, &dataset.id, &job, &files).await.unwrap();
    commit(tx).await.unwrap();
    assert_eq!(store.export_files(&export).await.unwrap(), files);
    assert_eq!(store.export_file(&export, "manifest.jsonl").await.unwrap(), files[1]);
    assert_eq!(store.export_file(&export, "../x").await.unwrap_err().kind(), Kind::NotFound);
}
