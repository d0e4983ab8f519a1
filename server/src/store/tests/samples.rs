//! Databases of earlier versions, dumped as SQL: each is opened, migrated, and consistent afterwards.
//!
//! A change of the schema adds a sample of the schema before it; see `tests/samples/README.md`.

use std::path::Path;

use sqlx::sqlite::{SqliteConnectOptions, SqlitePoolOptions};

use super::super::*;
use crate::{
    domain::{job::JobSpec, order::JobFilter},
    error::Kind,
};

/// A version, a dump, and the number of rows that each table must still have.
type Sample = (i64, &'static str, &'static [(&'static str, i64)]);

const SAMPLES: [Sample; 12] = [
    (
        8,
        include_str!("../../../../tests/samples/schema_0008.sql"),
        &[("episodes", 12), ("labels", 12), ("jobs", 2), ("encoders", 1), ("policies", 1), ("deployment_changes", 2)],
    ),
    (
        10,
        include_str!("../../../../tests/samples/schema_0010.sql"),
        &[("episodes", 12), ("jobs", 2), ("policies", 1), ("evaluations", 1), ("job_metrics", 6)],
    ),
    (
        17,
        include_str!("../../../../tests/samples/schema_0017.sql"),
        &[("episodes", 14), ("jobs", 7), ("score_runs", 1), ("datasets", 1), ("policies", 2), ("export_files", 33)],
    ),
    (
        20,
        include_str!("../../../../tests/samples/schema_0020.sql"),
        &[("episodes", 14), ("jobs", 7), ("audit", 1), ("policies", 2), ("export_files", 33)],
    ),
    (
        24,
        include_str!("../../../../tests/samples/schema_0024.sql"),
        &[("episodes", 12), ("jobs", 2), ("snapshots", 2), ("encoders", 2), ("audit", 1)],
    ),
    (
        25,
        include_str!("../../../../tests/samples/schema_0025.sql"),
        &[("episodes", 15), ("jobs", 7), ("score_runs", 1), ("datasets", 1), ("evaluations", 3), ("export_files", 35)],
    ),
    (
        26,
        include_str!("../../../../tests/samples/schema_0026.sql"),
        &[("episodes", 8), ("jobs", 11), ("score_runs", 2), ("datasets", 2), ("policies", 4), ("job_metrics", 6)],
    ),
    (
        27,
        include_str!("../../../../tests/samples/schema_0027.sql"),
        &[("episodes", 8), ("jobs", 11), ("score_runs", 3), ("datasets", 3), ("policies", 4), ("snapshots", 1)],
    ),
    (
        28,
        include_str!("../../../../tests/samples/schema_0028.sql"),
        &[("episodes", 10), ("jobs", 4), ("score_runs", 1), ("datasets", 1), ("policies", 2), ("job_metrics", 6)],
    ),
    (
        29,
        include_str!("../../../../tests/samples/schema_0029.sql"),
        &[("episodes", 10), ("jobs", 4), ("score_runs", 1), ("datasets", 1), ("policies", 2), ("job_metrics", 25)],
    ),
    (
        30,
        include_str!("../../../../tests/samples/schema_0030.sql"),
        &[("episodes", 10), ("jobs", 4), ("policies", 2), ("deployment_changes", 2), ("job_metrics", 25)],
    ),
    (
        31,
        include_str!("../../../../tests/samples/schema_0031.sql"),
        &[("episodes", 10), ("jobs", 4), ("policies", 2), ("schedules", 1), ("job_metrics", 25)],
    ),
];

async fn load(path: &Path, dump: &'static str) {
    let options = SqliteConnectOptions::new().filename(path).create_if_missing(true);
    let pool = SqlitePoolOptions::new().max_connections(1).connect_with(options).await.unwrap();
    sqlx::raw_sql(dump).execute(&pool).await.unwrap();
    pool.close().await;
}

#[tokio::test]
async fn every_sample_is_migrated_completely() {
    for (version, dump, counts) in SAMPLES {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("gleaner.db");
        load(&path, dump).await;

        // Reading migrates a copy, and leaves the file unchanged.
        let before = std::fs::read(&path).unwrap();
        let database = ReadOnlyDatabase::open(&path).await.unwrap();
        assert_eq!(database.schema, version);
        assert_eq!(database.store.wrong_rows().await.unwrap(), [], "schema {version}");
        database.store.close().await;
        assert!(std::fs::read(&path).unwrap() == before, "schema {version}");

        let store = Store::open(&path).await.unwrap();
        assert_eq!(known_version(&store).await, schema::newest());
        assert_eq!(store.integrity().await.unwrap(), [], "schema {version}");
        assert_eq!(store.wrong_rows().await.unwrap(), [], "schema {version}");
        for (table, expected) in counts {
            let query = format!("select count(*) from {table}");
            let found: i64 = row::query_as(sqlx::AssertSqlSafe(query)).fetch_one(store.read()).await.unwrap();
            assert_eq!(found, *expected, "{table} of schema {version}");
        }
        reads(&store).await;
    }
}

/// All rows are read through the functions of the server.
async fn reads(store: &Store) {
    for (task, _) in store.tasks().await.unwrap() {
        for policy in store.policies(&task.id).await.unwrap() {
            store.evaluations(&policy.id).await.unwrap();
        }
        for run in store.score_runs(&task.id).await.unwrap() {
            assert!(store.run_counts(&run).await.unwrap().imperfect_segments > 0);
            for scores in store.scores_behind(&run.id, -1, u32::MAX).await.unwrap().0 {
                store.episode_scores(&run.id, &scores.episode_id).await.unwrap();
            }
        }
        for dataset in store.datasets(&task.id).await.unwrap() {
            store.dataset_contents(&dataset.id).await.unwrap();
        }
        for snapshot in store.snapshots(&task.id).await.unwrap() {
            assert!(!store.snapshot(&snapshot.id).await.unwrap().1.is_empty());
            store.expect_recordings(&snapshot.id).await.unwrap();
        }
    }
    let (schedules, _) = store.schedules(None, None, 1000).await.unwrap();
    assert!(schedules.iter().all(|schedule| schedule.pipeline.is_ok() && schedule.engine_options.is_empty()));
    assert!(!store.jobs(&JobFilter::default(), None, 100).await.unwrap().0.is_empty());
    store.deployments(None).await.unwrap();
    store.named_blobs().await.unwrap();
}

#[tokio::test]
async fn trainings_of_schema_25_are_read_with_the_weighting_that_they_had() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("gleaner.db");
    let (.., dump, _) = SAMPLES[5];
    load(&path, dump).await;
    let store = Store::open(&path).await.unwrap();
    let specs = store.jobs(&JobFilter::default(), None, 100).await.unwrap().0.into_iter().map(|job| job.spec);
    let trainings: Vec<_> = specs
        .filter_map(|spec| match spec {
            JobSpec::Train { spec, .. } => Some(spec),
            JobSpec::Pretrain { .. } | JobSpec::Score { .. } | JobSpec::Export { .. } | JobSpec::Evaluate { .. } => {
                None
            }
        })
        .collect();
    assert_eq!(trainings.len(), 3);
    for spec in trainings {
        let of_bc = spec.policy.name == "bc";
        let lambda = if of_bc { 0.3 } else { 0.1 };
        assert_eq!((spec.weighting.name.as_str(), &spec.weighting.settings["lambda"]), ("quality", &lambda.into()));
        let gain = spec.policy.settings.get("keypoint_gain");
        assert_eq!(gain, of_bc.then_some(&1.0.into()));
    }
}

#[tokio::test]
async fn datasets_of_schema_25_have_no_shape() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("gleaner.db");
    let (.., dump, _) = SAMPLES[5];
    load(&path, dump).await;
    let store = Store::open(&path).await.unwrap();
    let mut datasets = Vec::new();
    for (task, _) in store.tasks().await.unwrap() {
        datasets.extend(store.datasets(&task.id).await.unwrap());
    }
    assert_eq!(datasets.len(), 1);
    assert!(datasets[0].selection.shape.is_off(), "{datasets:?}");
}

#[tokio::test]
async fn datasets_of_schema_26_keep_their_shape() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("gleaner.db");
    let (.., dump, _) = SAMPLES[6];
    load(&path, dump).await;
    let store = Store::open(&path).await.unwrap();
    let (task, _) = store.tasks().await.unwrap().remove(0);
    let datasets = store.datasets(&task.id).await.unwrap();
    assert_eq!(datasets.len(), 2);
    for dataset in datasets {
        let shape = dataset.selection.shape;
        assert_eq!((shape.min_run, shape.close_gaps, shape.context_before), (2, 1, 0));
    }
}

async fn known_version(store: &Store) -> i64 {
    row::query_as("select max(version) from _sqlx_migrations").fetch_one(store.read()).await.unwrap()
}

#[tokio::test]
async fn a_newer_database_is_refused_with_both_versions_and_left_alone() {
    let (dir, store) = testing::sqlite().await;
    let newer = schema::newest() + 5;
    testing::run(
        &store,
        &format!(
            "insert into _sqlx_migrations (version, description, success, checksum, execution_time) \
             values ({newer}, 'tomorrow', 1, x'00', 1)"
        ),
    )
    .await;
    store.close().await;
    let path = dir.path().join("gleaner.db");
    let before = std::fs::read(&path).unwrap();
    for error in [Store::open(&path).await.unwrap_err(), ReadOnlyDatabase::open(&path).await.unwrap_err()] {
        assert_eq!(error.kind(), Kind::Precondition, "{error}");
        for part in [newer, schema::newest()] {
            assert!(error.message().contains(&part.to_string()), "{error}");
        }
    }
    assert!(std::fs::read(&path).unwrap() == before);
}

#[tokio::test]
async fn a_foreign_sqlite_file_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("gleaner.db");
    load(&path, "create table songs (name text)").await;
    let error = ReadOnlyDatabase::open(&path).await.unwrap_err();
    assert!(error.kind() == Kind::Precondition && error.message().contains("is not a gleaner database"), "{error}");
}
