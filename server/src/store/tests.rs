//! A database of an earlier version is migrated with every row it had.

mod course;
mod lists;
mod pages;

mod samples;

use sqlx::sqlite::{SqliteConnectOptions, SqlitePoolOptions};

use super::*;
use crate::domain::{
    id::{DatasetId, JobId, PolicyId, ScoreRunId, TaskId},
    job::JobSpec,
    selection::Selection,
};

/// The last migration before evaluations, keys, selections and policies from scratch.
const EARLIER: usize = 8;

#[tokio::test]
async fn rows_of_an_earlier_version_are_kept() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("gleaner.db");
    let (job, second, run) = (JobId::new(), JobId::new(), ScoreRunId::new());
    let (task, dataset, policy) = (TaskId::new(), DatasetId::new(), PolicyId::new());
    {
        let options = SqliteConnectOptions::new().filename(&path).create_if_missing(true).foreign_keys(true);
        let old = SqlitePoolOptions::new().max_connections(1).connect_with(options).await.unwrap();
        let before = sqlx::migrate::Migrator::with_migrations(schema::SQLITE.migrations[..EARLIER].to_vec());
        before.run(&old).await.unwrap();
        let encoder = crate::domain::id::EncoderId::new();
        let snapshot = crate::domain::id::SnapshotId::new();
        let score = format!(
            r#"{{"kind":"score","encoder_id":"{encoder}","snapshot_id":"{snapshot}","spec":{{"similarity":"last_l2",
            "normaliser":"min_max","modality_scale":null,"device":"cpu","threads":null}}}}"#
        );
        let train = format!(
            r#"{{"kind":"train","encoder_id":"{encoder}","snapshot_id":"{snapshot}","dataset_id":null,
            "spec":{{"policy":"finetune","lambda":0.3,"seed":4}}}}"#
        );
        let blob = blake3::hash(b"policy").to_hex();
        let statements = [
            format!("insert into tasks values ('{task}', 'reach', '{{}}', 1)"),
            format!("insert into snapshots values ('{snapshot}', '{task}', '{{}}', 1)"),
            format!(
                "insert into jobs (id, task_id, kind, spec, state, priority, result_id, max_attempts, created_at) \
                 values ('{job}', '{task}', 'score', '{score}', 'succeeded', 0, '{run}', 3, 1), \
                 ('{second}', '{task}', 'train', '{train}', 'queued', 0, '{policy}', 3, 1)"
            ),
            format!("insert into job_dependencies values ('{second}', '{job}')"),
            format!("insert into encoders values ('{encoder}', '{task}', '{job}', '{snapshot}', '{blob}', 1)"),
            format!(
                "insert into score_runs values ('{run}', '{task}', '{job}', '{encoder}', '{snapshot}', 'last_l2', \
                 'minmax', -2, -1, '[]', 1)"
            ),
            format!("insert into datasets values ('{dataset}', '{task}', '{run}', 0.5, 1)"),
            format!(
                "insert into policies values ('{policy}', '{task}', '{second}', 'finetune', '{encoder}', '{dataset}', \
                 '{blob}', 1)"
            ),
            format!("insert into deployments values ('arm@prod', '{task}')"),
            format!("insert into deployment_changes values (1, 'arm@prod', '{policy}', 1)"),
        ];
        for statement in statements {
            sqlx::raw_sql(sqlx::AssertSqlSafe(statement)).execute(&old).await.unwrap();
        }
        old.close().await;
    }

    let store = Store::open(&path).await.unwrap();
    let broken: Vec<String> =
        row::query_as("select \"table\" from pragma_foreign_key_check").fetch_all(store.read()).await.unwrap();
    assert!(broken.is_empty(), "{broken:?}");
    let JobSpec::Score { extends: None, spec: score, .. } = store.job(&job).await.unwrap().spec else {
        panic!("not score")
    };
    let plain = |spec: &gleaner_core::ScoreSpec| {
        let set = &spec.scorer.settings;
        (spec.scorer.name.clone(), set["feature_scale"].clone(), set["local_scale"].clone())
    };
    assert_eq!(plain(&score), ("ssdf".to_owned(), "plain".into(), false.into()), "as it was made");
    let train = store.job(&second).await.unwrap();
    assert_eq!((train.needs, train.key.as_str()), (vec![job], ""));
    assert!(
        matches!(train.spec, JobSpec::Train { encoder_id: Some(_), ref spec, .. } if spec.weighting.settings["lambda"] == 0.3)
    );
    let read = store.score_run(&run).await.unwrap();
    assert_eq!((read.origin.values(), read.extends, read.quantiles.len()), (score.values(), None, 0));
    assert_eq!(store.dataset(&dataset).await.unwrap().selection, Selection::beta(0.5));
    assert!(store.policy(&policy).await.unwrap().training().unwrap().encoder_id.is_some());
    assert_eq!(store.deployment("arm@prod").await.unwrap().policy_id(), Some(&policy));
}
