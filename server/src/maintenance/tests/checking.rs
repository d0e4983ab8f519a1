//! `check` finds and names every problem, and none in an intact folder.

use std::fs;

use super::*;
use crate::{config::Cli, error::Kind, ingest::part_path};

async fn problems(lab: &Lab, fast: bool) -> Vec<String> {
    let report = checked(lab.dir.path(), fast).await;
    let problems =
        report.findings.into_iter().filter(|finding| finding.severity == super::super::report::Severity::Problem);
    problems.map(|finding| format!("{}: {}", finding.subject, finding.detail)).collect()
}

#[tokio::test]
async fn an_intact_folder_has_no_problem_beside_its_open_server() {
    let lab = lab().await;
    let report = checked(lab.dir.path(), false).await;
    assert!(report.sound && report.findings.is_empty(), "{:?}", report.findings);
    assert_eq!((report.blobs, report.bytes), (3, 21));
    // The database is open and being written.
    testing::episode(&lab.store, &lab.task, Outcome::Success, "").await;
}

#[tokio::test]
async fn bit_rot_is_reported_with_all_rows_that_need_the_blob() {
    let lab = lab().await;
    fs::write(lab.blobs.path(&lab.checkpoint), b"encodes").unwrap();
    assert!(problems(&lab, true).await.is_empty(), "the size is right, and --fast reads nothing");
    let problems = problems(&lab, false).await;
    assert_eq!(problems.len(), 1, "{problems:?}");
    assert!(problems[0].starts_with(&format!("blob {}: is damaged", lab.checkpoint)), "{problems:?}");
    assert!(problems[0].contains("enc_") && problems[0].contains("pol_"), "{problems:?}");
}

#[tokio::test]
async fn a_missing_or_short_blob_is_found_by_size() {
    let lab = lab().await;
    fs::write(lab.blobs.path(&lab.recording), b"fail").unwrap();
    fs::remove_file(lab.blobs.path(&lab.checkpoint)).unwrap();
    let problems = problems(&lab, true).await;
    assert!(problems.iter().any(|p| p.contains("has 4 bytes, not 7") && p.contains("ep_")), "{problems:?}");
    assert!(problems.iter().any(|p| p.contains("is not there") && p.contains("pol_")), "{problems:?}");
    assert_eq!(problems.len(), 2);
}

#[tokio::test]
async fn unneeded_files_are_noted_without_a_problem() {
    let lab = lab().await;
    let orphan = lab.blobs.put(b"orphan").unwrap();
    fs::write(lab.dir.path().join("blobs/README"), b"?").unwrap();
    fs::create_dir_all(lab.dir.path().join("rollouts/unusable")).unwrap();
    fs::write(lab.dir.path().join("rollouts/unusable/ses_1.mcap"), b"torn").unwrap();
    let report = checked(lab.dir.path(), false).await;
    assert!(report.sound, "{:?}", report.findings);
    for subject in [orphan.as_str(), "README", "ses_1.mcap"] {
        assert!(report.findings.iter().any(|finding| finding.subject.contains(subject)), "{:?}", report.findings);
    }
}

#[tokio::test]
async fn lost_bytes_of_an_upload_are_found() {
    let lab = lab().await;
    let upload = testing::upload(&lab.task, b"half of it");
    lab.store.insert_upload(&upload, None).await.unwrap();
    fs::create_dir_all(lab.dir.path().join("uploads")).unwrap();
    let part = part_path(lab.dir.path(), &upload.id);
    fs::write(&part, b"half").unwrap();
    lab.store.commit_upload(&upload.id, 4).await.unwrap();
    assert!(problems(&lab, true).await.is_empty());
    fs::write(&part, b"ha").unwrap();
    assert!(problems(&lab, true).await[0].contains("only 2 bytes"));
    fs::remove_file(&part).unwrap();
    assert!(problems(&lab, true).await[0].contains("has no file"));
}

/// Every rule is broken once, by hand, and reported.
#[tokio::test]
async fn rows_that_contradict_each_other_are_found() {
    let lab = lab().await;
    for (breaking, expected) in [
        ("update tasks set spec = '{}'", "its spec does not read"),
        ("update snapshots set rule = '{'", "its rule does not read"),
        ("update jobs set spec = '{\"kind\":\"dream\"}'", "its spec does not read"),
        ("update episodes set outcome = 'unknown'", "not the newest of its history"),
        ("delete from labels", "not the newest of its history"),
        ("update jobs set result_id = id", "is not there"),
        ("update jobs set state = 'queued'", "did not make it"),
        ("update jobs set token_hash = 'x'", "still has a checkpoint or a token"),
        ("delete from snapshot_episodes where role = 'expert'", "no expert or no imperfect"),
        ("update snapshots set expert_steps = expert_steps + 1", "its counts are not those of its episodes"),
        ("insert into deployments select 'arm@prod', id from tasks", "points at no policy"),
    ] {
        let before = lab.dir.path().join("before.db");
        lab.store.copy_to(&before).await.unwrap();
        testing::run(&lab.store, breaking).await;
        let found = problems(&lab, true).await;
        assert!(found.iter().any(|problem| problem.contains(expected)), "{breaking}: {found:?}");
        // All repaired at once.
        testing::run(&lab.store, &format!("attach '{}' as before", before.display())).await;
        for table in ["deployments", "labels", "episodes", "snapshot_episodes", "snapshots", "jobs", "tasks"] {
            testing::run(&lab.store, &format!("pragma foreign_keys = off; delete from {table}")).await;
            testing::run(&lab.store, &format!("insert into {table} select * from before.{table}")).await;
        }
        testing::run(&lab.store, "detach before; pragma foreign_keys = on").await;
        assert!(problems(&lab, true).await.is_empty(), "{breaking}");
        fs::remove_file(&before).unwrap();
    }
}

#[tokio::test]
async fn a_dangling_row_is_found() {
    let lab = lab().await;
    testing::run(&lab.store, "pragma foreign_keys = off; delete from snapshots; pragma foreign_keys = on").await;
    let found = problems(&lab, true).await;
    assert!(found.iter().any(|problem| problem.contains("a row of snapshots that does not exist")), "{found:?}");
}

#[tokio::test]
async fn a_folder_without_a_database_is_refused() {
    use clap::Parser as _;
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().to_str().unwrap();
    let cli = Cli::try_parse_from(["gleaner-server", "check", "--data-dir", path, "--json"]).unwrap();
    let crate::config::Command::Keep(crate::config::MaintenanceCommand::Check(config)) = cli.command else {
        unreachable!("the command is check")
    };
    let error = super::super::check::check(&config, &mut Vec::new()).await.unwrap_err();
    assert_eq!(error.kind(), Kind::Precondition);
    assert!(error.message().contains("--data-dir") && error.message().contains(path), "{error}");
    assert!(fs::read_dir(dir.path()).unwrap().next().is_none(), "a check creates nothing");
}

#[tokio::test]
async fn the_report_reads_as_json() {
    let lab = lab().await;
    fs::remove_file(lab.blobs.path(&lab.recording)).unwrap();
    let config = CheckConfig {
        data_dir: lab.dir.path().to_owned(),
        fast: true,
        json: true,
        database: DatabaseConfig::default(),
    };
    let mut out = Vec::new();
    assert!(!super::super::check::check(&config, &mut out).await.unwrap());
    let report: serde_json::Value = serde_json::from_slice(&out).unwrap();
    assert_eq!((&report["sound"], &report["blobs"]), (&false.into(), &3.into()));
    assert_eq!(report["findings"][0]["severity"], "problem");
}
