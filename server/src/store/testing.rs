//! Fixtures for tests of this crate: a fresh database, and rows in it.

pub(crate) mod results;

use std::sync::atomic::{AtomicU64, Ordering};

use gleaner_recording::{Alignment, FieldSpec, Report, TaskSpec};
use tempfile::TempDir;

use super::Store;
use crate::domain::{
    client::Client,
    episode::{Episode, InspectedEpisode, Outcome, Upload},
    id::{EpisodeId, UploadId},
    task::Task,
    time::Millis,
};

/// A counter that makes contents differ.
static CONTENT: AtomicU64 = AtomicU64::new(0);

/// A fresh database, removed with the folder.
pub(crate) async fn store() -> (TempDir, Store) {
    let dir = tempfile::tempdir().unwrap();
    let store = Store::open(&dir.path().join("gleaner.db")).await.unwrap();
    (dir, store)
}

/// A task without cameras: two joints, one action, 10 steps a second.
pub(crate) fn spec() -> TaskSpec {
    let field = |name: &str, size| FieldSpec::new(name, size);
    TaskSpec {
        name: "reach".into(),
        rate_hz: 10.0,
        cameras: Vec::new(),
        proprioception: vec![field("joint_position", 2)],
        action: vec![field("joint_velocity", 1)],
        alignment: Alignment::LatestBefore,
        tolerance: 0.25,
        mappings: Vec::new(),
    }
}

/// The task of [`spec`], stored.
pub(crate) async fn task(store: &Store) -> Task {
    store.insert_task(&spec()).await.unwrap()
}

/// An upload of `content`, not stored, of an episode labelled success.
pub(crate) fn upload(task: &Task, content: &[u8]) -> Upload {
    Upload {
        id: UploadId::new(),
        task_id: task.id.clone(),
        file_name: "reach.mcap".into(),
        size_bytes: content.len() as u64,
        blake3: blake3::hash(content).into(),
        committed: 0,
        outcome: Outcome::Success,
        cohort: String::new(),
        author: "tests".into(),
        client: Client::Token("tests".into()),
    }
}

/// An inspection's report on the upload: 20 steps, no finding.
pub(crate) fn inspected(task: &Task, upload: &Upload) -> InspectedEpisode {
    let episode = Episode {
        id: EpisodeId::new(),
        task_id: task.id.clone(),
        file_name: upload.file_name.clone(),
        recording: upload.blake3.clone(),
        size_bytes: upload.size_bytes,
        steps: 20,
        duration_s: 1.9,
        mapping: "plain".into(),
        warnings: 0,
        outcome: upload.outcome,
        cohort: upload.cohort.clone(),
        created_at: Millis::now(),
        deleted_at: None,
    };
    InspectedEpisode { episode, report: Report { steps: 20, mapping: "plain".into(), ..Report::default() } }
}

/// A stored episode of 20 steps with unique content (rows only, no blob).
pub(crate) async fn episode(store: &Store, task: &Task, outcome: Outcome, cohort: &str) -> Episode {
    let content = format!("recording {}", CONTENT.fetch_add(1, Ordering::Relaxed));
    let upload = Upload { outcome, cohort: cohort.to_owned(), ..upload(task, content.as_bytes()) };
    store.insert_upload(&upload, None).await.unwrap();
    store.finish_upload(&upload, &inspected(task, &upload)).await.unwrap()
}

/// Runs raw SQL, for states that this program never creates.
pub(crate) async fn run(store: &Store, statement: &str) {
    sqlx::raw_sql(sqlx::AssertSqlSafe(statement)).execute(&store.writer).await.unwrap();
}

/// The steps of the plan of a query, as text.
pub(crate) async fn plan(store: &Store, query: &str) -> Vec<String> {
    let steps: Vec<(i64, i64, i64, String)> =
        sqlx::query_as(sqlx::AssertSqlSafe(format!("explain query plan {query}")))
            .fetch_all(store.read())
            .await
            .unwrap();
    steps.into_iter().map(|step| step.3).collect()
}
