//! Fixtures for tests of this crate: a fresh database, and rows in it.

pub(crate) mod results;

use std::sync::atomic::{AtomicU64, Ordering};

use gleaner_recording::{Alignment, FieldSpec, Report, TaskSpec};
use tempfile::TempDir;

use super::{Postgres, Store, row, sql::Pool};
use crate::domain::{
    attempt::Attempt,
    client::Client,
    episode::{Episode, InspectedEpisode, Outcome, Upload},
    id::{DatasetId, EpisodeId, ExportId, JobId, TaskId, UploadId},
    job::JobSpec,
    order::{NewJob, Plan},
    task::Task,
    time::Millis,
};

/// A counter that makes contents differ.
static CONTENT: AtomicU64 = AtomicU64::new(0);

/// A fresh database, in PostgreSQL if the tests are to use that, else in the folder.
pub(crate) async fn store() -> (TempDir, Store) {
    if !gleaner_test_postgres::selected() {
        return sqlite().await;
    }
    let dir = tempfile::tempdir().unwrap();
    (dir, Store::serve_postgres(&postgres().await).await.unwrap())
}

/// A fresh SQLite database, removed with the folder, for what SQLite alone does.
pub(crate) async fn sqlite() -> (TempDir, Store) {
    let dir = tempfile::tempdir().unwrap();
    let store = Store::open(&dir.path().join("gleaner.db")).await.unwrap();
    (dir, store)
}

/// Whether the tests run on PostgreSQL; else prints that a test which needs it is skipped.
pub(crate) fn postgres_selected() -> bool {
    let selected = gleaner_test_postgres::selected();
    if !selected {
        let variable = gleaner_test_postgres::VARIABLE;
        // The harness captures the output of the macros only.
        std::io::Write::write_fmt(
            &mut std::io::stderr(),
            format_args!("SKIPPED: runs with {variable}=postgres alone\n"),
        )
        .unwrap();
    }
    selected
}

/// An empty database in the private PostgreSQL of this process's tests.
pub(crate) async fn postgres() -> Postgres {
    let server = tokio::task::spawn_blocking(|| {
        let server = gleaner_test_postgres::shared();
        server.url(&server.database())
    });
    Postgres::at(&server.await.unwrap()).unwrap()
}

/// A task without cameras: two joints, one action, 10 steps a second.
pub(crate) fn spec() -> TaskSpec {
    let field = |name: &str, size| FieldSpec::new(name, size);
    TaskSpec {
        name: "reach".into(),
        instruction: String::new(),
        openpi: Vec::new(),
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

/// The first attempt of a new job, an export, that runs on an engine.
pub(crate) async fn claimed(store: &Store, task: &TaskId, engine: &str) -> Attempt {
    let job = NewJob {
        id: JobId::new(),
        task_id: task.clone(),
        spec: JobSpec::Export { dataset_id: DatasetId::new(), spec: Default::default() },
        result_id: ExportId::new().into(),
        priority: 0,
        max_attempts: 3,
        engine_options: String::new(),
        needs: Vec::new(),
        keyed: None,
    };
    store.insert_plan(&Plan { jobs: vec![job], ..Plan::default() }).await.unwrap();
    let token_hash = JobId::new().to_string();
    let job = store.claim_job(&token_hash, engine).await.unwrap().unwrap();
    Attempt { job_id: job.id, token_hash }
}

/// Runs raw SQL, for states that this program never creates.
pub(crate) async fn run(store: &Store, statement: &str) {
    let statement = sqlx::raw_sql(sqlx::AssertSqlSafe(statement));
    match &store.writer {
        Pool::Sqlite(pool) => drop(statement.execute(pool).await.unwrap()),
        Pool::Postgres(pool) => drop(statement.execute(pool).await.unwrap()),
    }
}

/// Has the database reject writes, as on a disk that cannot be written, or accept them again.
pub(crate) async fn set_read_only(store: &Store, read_only: bool) {
    let setting = match &store.writer {
        Pool::Sqlite(_) => "pragma query_only",
        Pool::Postgres(_) => "set default_transaction_read_only",
    };
    run(store, &format!("{setting} = {read_only}")).await;
}

/// The steps of the plan of a query in SQLite, as text.
pub(crate) async fn plan(store: &Store, query: &str) -> Vec<String> {
    let steps: Vec<(i64, i64, i64, String)> = row::query_as(sqlx::AssertSqlSafe(format!("explain query plan {query}")))
        .fetch_all(store.read())
        .await
        .unwrap();
    steps.into_iter().map(|step| step.3).collect()
}
