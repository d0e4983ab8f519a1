//! Snapshots and encoders as requested by browsers and programs.

use http::StatusCode;
use serde_json::Value;

use crate::{
    domain::{
        dataset::ExportFile,
        episode::{NewLabel, Outcome},
        id::{EncoderId, ExportId, SnapshotId},
        job::{JobSpec, JobState},
        score::Encoder,
        selection::Selection,
        snapshot::Role,
        task::Task,
        time::Millis,
    },
    pages::testing::{Client, Pages},
    store::testing::{self, results},
};

/// An encoder of a snapshot with one expert and one failure of bob's.
async fn encoder(pages: &Pages) -> (Task, Encoder) {
    let store = &pages.services.store;
    let task = testing::task(store).await;
    testing::episode(store, &task, Outcome::Success, "").await;
    testing::episode(store, &task, Outcome::Failure, "bob").await;
    let encoder = results::encoder(store, &task).await;
    results::set_state(store, &encoder.job_id, JobState::Succeeded, "").await;
    (task, encoder)
}

async fn text(pages: &Pages, path: &str) -> String {
    let shown = pages.get(&Client::default(), path).await;
    assert_eq!(shown.status, StatusCode::OK, "{path}: {}", shown.text());
    shown.text()
}

async fn rows(pages: &Pages, path: &str) -> Vec<Value> {
    serde_json::from_str(&text(pages, path).await).unwrap()
}

#[tokio::test]
async fn a_snapshot_shows_its_labels_after_they_changed() {
    let pages = Pages::open(false).await;
    let (_, encoder) = encoder(&pages).await;
    let path = format!("/snapshots/{}", encoder.snapshot_id);
    let before = text(&pages, &path).await;
    assert!(
        before.contains("experts were labelled success, imperfect failure") && !before.contains(">now<"),
        "{before}"
    );
    let content = rows(&pages, &format!("{path}?format=json")).await;
    let failure = content.iter().find(|row| row["role"] == "imperfect").unwrap().clone();
    assert_eq!((&failure["outcome"], &failure["outcome_now"]), (&"failure".into(), &"failure".into()));

    let episode = serde_json::from_value(failure["episode_id"].clone()).unwrap();
    let cohort = Some("=carol".to_owned());
    let label = NewLabel { outcome: Some(Outcome::Unknown), cohort, author: "ada".into(), reason: String::new() };
    pages.services.store.label_episodes(std::slice::from_ref(&episode), &label).await.unwrap();
    let after = text(&pages, &path).await;
    let row = after.split("<tr>").find(|row| row.contains(&format!("/episodes/{episode}"))).unwrap();
    let (then, now) = row.split_once(">now<").unwrap();
    assert!(then.contains("tag failure") && then.contains("bob"), "{row}");
    assert!(now.contains("tag unknown") && now.contains("=carol"), "{row}");
    assert!(after.contains("<dt>Relabelled since</dt><dd>1</dd>"), "{after}");

    let content = rows(&pages, &format!("{path}?format=json")).await;
    let changed = content.iter().find(|row| row["episode_id"] == failure["episode_id"]).unwrap();
    assert_eq!((&changed["outcome"], &changed["cohort"]), (&"failure".into(), &"bob".into()));
    assert_eq!(changed["label_version"], failure["label_version"]);
    assert!(changed["label_version_now"].as_i64() > failure["label_version_now"].as_i64());
    let csv = text(&pages, &format!("{path}?format=csv")).await;
    assert_eq!(csv.lines().count(), 1 + 2, "{csv}");
    assert!(csv.starts_with("episode_id,file_name,role,outcome,cohort,label_version,outcome_now,"), "{csv}");
    assert!(csv.contains(",failure,bob,") && csv.contains(",unknown,'=carol,"), "{csv}");
}

#[tokio::test]
async fn a_removed_recording_is_not_a_link() {
    let pages = Pages::open(false).await;
    let (_, encoder) = encoder(&pages).await;
    let path = format!("/snapshots/{}", encoder.snapshot_id);
    let content = rows(&pages, &format!("{path}?format=json")).await;
    let episode = serde_json::from_value(content[0]["episode_id"].clone()).unwrap();
    let link = format!("href=\"/episodes/{episode}\"");
    let store = &pages.services.store;
    store.delete_episodes(std::slice::from_ref(&episode), true).await.unwrap();
    let shown = text(&pages, &path).await;
    assert!(
        shown.contains("in the trash") && shown.contains(&link) && !shown.contains("permanently deleted"),
        "{shown}"
    );
    assert_eq!(store.sweep_trash(Millis(i64::MAX)).await.unwrap().purged, 1);
    let shown = text(&pages, &path).await;
    assert!(shown.contains("recording deleted") && !shown.contains(&link), "{shown}");
    assert!(shown.contains("permanently deleted"), "{shown}");
    assert_eq!(rows(&pages, &format!("{path}?format=json")).await[0]["standing"], "deleted");
}

#[tokio::test]
async fn a_snapshot_and_an_encoder_link_to_their_results() {
    let pages = Pages::open(false).await;
    let (task, encoder) = encoder(&pages).await;
    let store = &pages.services.store;
    let run = results::run(store, &task, &encoder, &[]).await;
    results::set_state(store, run.origin.job_id().unwrap(), JobState::Succeeded, "").await;
    let dataset = store.insert_dataset(&run.id, Selection::beta(0.5)).await.unwrap();
    let policy = results::policy(store, &task, &encoder, blake3::hash(b"policy").into()).await;
    results::set_state(store, policy.job_id().unwrap(), JobState::Succeeded, "").await;
    let link = |to: &str, id: &str| format!("href=\"/{to}/{id}\"");

    let shown = text(&pages, &format!("/snapshots/{}", encoder.snapshot_id)).await;
    for (to, id) in [
        ("encoders", encoder.id.as_str()),
        ("runs", run.id.as_str()),
        ("datasets", dataset.id.as_str()),
        ("policies", policy.id.as_str()),
    ] {
        assert!(shown.contains(&link(to, id)), "{to} are not in {shown}");
    }
    let shown = text(&pages, &format!("/encoders/{}", encoder.id)).await;
    for (to, id) in [
        ("snapshots", encoder.snapshot_id.as_str()),
        ("jobs", encoder.job_id.as_str()),
        ("runs", run.id.as_str()),
        ("policies", policy.id.as_str()),
    ] {
        assert!(shown.contains(&link(to, id)), "{to} are not in {shown}");
    }
    assert!(shown.contains("masked transition prediction, transition reconstruction, action autoregression"));
    assert!(shown.contains(encoder.checkpoint.as_str()), "{shown}");
}

#[tokio::test]
async fn invalid_and_unknown_ids_are_refused() {
    let pages = Pages::open(false).await;
    let (task, encoder) = encoder(&pages).await;
    let coming = EncoderId::new();
    let job = pages.services.store.job(&encoder.job_id).await.unwrap();
    results::job(&pages.services.store, &task, job.spec, coming.as_str()).await;
    for (path, status, message) in [
        ("/snapshots/7".to_owned(), StatusCode::BAD_REQUEST, "id: "),
        (format!("/snapshots/{}", encoder.id), StatusCode::BAD_REQUEST, "a snapshot"),
        (format!("/snapshots/{}", SnapshotId::new()), StatusCode::NOT_FOUND, "snapshot"),
        (format!("/snapshots/{}?format=xml", encoder.snapshot_id), StatusCode::BAD_REQUEST, "format"),
        ("/encoders/7".to_owned(), StatusCode::BAD_REQUEST, "id: "),
        (format!("/encoders/{}", EncoderId::new()), StatusCode::NOT_FOUND, "encoder"),
        (format!("/encoders/{coming}"), StatusCode::CONFLICT, "encoder"),
    ] {
        let refused = pages.get(&Client::default(), &path).await;
        assert_eq!(refused.status, status, "{path}");
        assert!(refused.text().contains(message), "{path}: {}", refused.text());
    }
}

#[tokio::test]
async fn a_dataset_shows_its_inputs_and_later_results() {
    let pages = Pages::open(false).await;
    let store = &pages.services.store;
    let task = testing::task(store).await;
    testing::episode(store, &task, Outcome::Success, "").await;
    let failure = testing::episode(store, &task, Outcome::Failure, "").await;
    let encoder = results::encoder(store, &task).await;
    let scores = results::scores(&failure.id, Role::Imperfect, &[0.5; 20]);
    let run = results::run(store, &task, &encoder, &[scores]).await;
    let dataset = store.insert_dataset(&run.id, Selection::beta(0.25)).await.unwrap();
    let export = ExportId::new();
    results::job(
        store,
        &task,
        JobSpec::Export { dataset_id: dataset.id.clone(), spec: Default::default() },
        export.as_str(),
    )
    .await;

    let shown = text(&pages, &format!("/datasets/{}", dataset.id)).await;
    for there in [encoder.snapshot_id.as_str(), encoder.id.as_str(), run.id.as_str(), export.as_str()] {
        assert!(shown.contains(there), "{there} is not in {shown}");
    }
    assert!(shown.contains("1 expert, 1 imperfect") && shown.contains("q &gt; 0.25"), "{shown}");
    let shown = text(&pages, &format!("/jobs/{}", run.origin.job_id().unwrap())).await;
    assert!(shown.contains(&format!("/datasets/{}", dataset.id)) && shown.contains(export.as_str()), "{shown}");
}

#[tokio::test]
async fn the_job_of_an_export_shows_whether_its_files_are_kept() {
    let pages = Pages::open(false).await;
    let store = &pages.services.store;
    let (task, encoder) = encoder(&pages).await;
    let run = results::run(store, &task, &encoder, &[]).await;
    let dataset = store.insert_dataset(&run.id, Selection::beta(0.25)).await.unwrap().id;
    let file = ExportFile { name: "a.mcap".into(), blob: blake3::hash(b"a").into(), size_bytes: 1 };
    let export = results::export(store, &task, &dataset, &[file]).await;
    let job = store.job_of_result(export.as_str()).await.unwrap().unwrap().id;
    let shown = text(&pages, &format!("/jobs/{job}")).await;
    assert!(shown.contains("1 file") && shown.contains("downloads"), "{shown}");
    store.forget_export_files(&export, 0).await.unwrap();
    let shown = text(&pages, &format!("/jobs/{job}")).await;
    assert!(shown.contains("are no longer kept") && shown.contains("export its dataset again"), "{shown}");
}
