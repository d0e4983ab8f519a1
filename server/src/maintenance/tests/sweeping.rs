//! The sweep removes unneeded data only, beside concurrent uploads, jobs and copies.

use std::{
    fs,
    time::{Duration, SystemTime},
};

use super::{super::sweep::SweepCounts, *};
use crate::{
    blobs::Copying,
    config::MaintenanceConfig,
    domain::{access::AuditEntry, episode::Upload, job::JobSpec, time::Millis},
    ingest::testing::{USABLE, playing},
    maintenance::{Sweeper, forget},
};

pub(super) const DAY: Duration = Duration::from_secs(24 * 60 * 60);

pub(super) fn sweeper(lab: &Lab, trash_days: u32) -> Sweeper {
    let data_dir = lab.dir.path().to_owned();
    fs::create_dir_all(data_dir.join("cache")).unwrap();
    Sweeper {
        store: lab.store.clone(),
        blobs: lab.blobs.clone(),
        ingest: lab.ingest.clone(),
        data_dir,
        maintenance: MaintenanceConfig {
            trash_days,
            log_days: 90,
            features_days: 7,
            export_days: 30,
            audit_days: None,
            max_cache_bytes: None,
            max_sweep_share: 0.05,
            accept_database: false,
            min_free_bytes: 0,
        },
    }
}

pub(super) fn in_days(days: u32) -> SystemTime {
    SystemTime::now() + DAY * days + Duration::from_secs(60)
}

pub(super) async fn stored(lab: &Lab, content: &[u8]) -> crate::domain::episode::Episode {
    let upload = Upload { outcome: Outcome::Unknown, ..testing::upload(&lab.task, content) };
    lab.blobs.put(content).unwrap();
    lab.store.finish_upload(&upload, &testing::inspected(&lab.task, &upload)).await.unwrap()
}

#[tokio::test]
async fn the_trash_is_emptied_after_its_days() {
    let lab = lab().await;
    let (sweeper, gone) = (sweeper(&lab, 30), stored(&lab, b"mistake").await);
    let cache = sweeper.data_dir.join(format!("cache/{}-0123456789abcdef.frames", gone.recording));
    fs::write(&cache, b"decoded").unwrap();
    lab.store.delete_episodes(std::slice::from_ref(&gone.id), false).await.unwrap();
    assert_eq!(sweeper.sweep(in_days(29)).await.unwrap(), SweepCounts::default());
    assert!(lab.blobs.contains(&gone.recording));
    let counts = sweeper.sweep(in_days(30)).await.unwrap();
    assert_eq!(counts, SweepCounts { episodes: 1, blobs: 1, bytes: 7, caches: 1, ..SweepCounts::default() });
    assert!(!lab.blobs.contains(&gone.recording) && !cache.exists());
    assert!(checked(lab.dir.path(), false).await.findings.is_empty());
}

#[tokio::test]
async fn content_of_another_episode_stays() {
    let lab = lab().await;
    // The same bytes as those of the encoder.
    let (sweeper, gone) = (sweeper(&lab, 0), stored(&lab, b"encoder").await);
    lab.store.delete_episodes(std::slice::from_ref(&gone.id), false).await.unwrap();
    let counts = sweeper.sweep(in_days(1)).await.unwrap();
    assert_eq!((counts.episodes, counts.blobs), (1, 0));
    assert!(lab.blobs.contains(&lab.checkpoint));
}

#[tokio::test]
async fn blobs_without_a_row_are_removed_once_old_enough() {
    let lab = lab().await;
    let mut sweeper = sweeper(&lab, 30);
    let orphan = lab.blobs.put(b"of a job that died").unwrap();
    assert_eq!(sweeper.sweep(SystemTime::now()).await.unwrap().trashed, 0, "too young");
    let long_ago = SystemTime::now() - Duration::from_secs(60);
    fs::File::open(lab.blobs.path(&orphan)).unwrap().set_modified(long_ago).unwrap();
    // A blob stored after the start of an attempt may belong to the attempt.
    let encoder = crate::domain::id::EncoderId::new();
    let snapshot_id = lab.store.create_snapshot(&lab.task.id, &Default::default()).await.unwrap().id;
    let spec = JobSpec::Pretrain { snapshot_id, spec: Default::default() };
    let job = results::job(&lab.store, &lab.task, spec, encoder.as_str()).await;
    let claimed = lab.store.claim_job("token", "local").await.unwrap().unwrap();
    assert_eq!(claimed.id, job);
    let its_own = lab.blobs.put(b"of the running job").unwrap();
    let log = lab.dir.path().join("logs").join("of the running job");
    fs::create_dir_all(log.parent().unwrap()).unwrap();
    fs::write(&log, b"begins").unwrap();
    sweeper.maintenance.log_days = 0;
    assert_eq!(sweeper.sweep(in_days(5)).await.unwrap().trashed, 1, "the attempt is younger than that one");
    assert!(!lab.blobs.contains(&orphan) && lab.blobs.contains(&its_own) && log.exists());
    results::set_state(&lab.store, &job, crate::domain::job::JobState::Failed, "").await;
    assert_eq!(sweeper.sweep(in_days(5)).await.unwrap().trashed, 1);
    assert!(!lab.blobs.contains(&its_own) && lab.blobs.contains(&lab.recording) && !log.exists());
}

#[tokio::test]
async fn an_upload_interrupted_before_its_row_keeps_its_blob() {
    let lab = lab().await;
    let sweeper = sweeper(&lab, 30);
    let upload = Upload { committed: 4, ..testing::upload(&lab.task, b"late") };
    lab.store.insert_upload(&upload, None).await.unwrap();
    lab.blobs.put(b"late").unwrap();
    sweeper.sweep(in_days(9)).await.unwrap();
    assert!(lab.blobs.contains(&upload.blake3));
    lab.store.delete_upload(&upload.id).await.unwrap();
    sweeper.sweep(in_days(9)).await.unwrap();
    assert!(!lab.blobs.contains(&upload.blake3));
}

#[tokio::test]
async fn no_blob_is_removed_while_the_folder_is_copied() {
    let lab = lab().await;
    let (sweeper, orphan) = (sweeper(&lab, 30), lab.blobs.put(b"orphan").unwrap());
    let copying = Copying::begin(lab.dir.path()).unwrap();
    assert_eq!(sweeper.sweep(in_days(2)).await.unwrap().blobs, 0);
    assert!(lab.blobs.contains(&orphan));
    drop(copying);
    assert_eq!(sweeper.sweep(in_days(2)).await.unwrap().trashed, 1);
}

/// The same content is pushed and deleted repeatedly, while another task constantly tries to remove it. Stored content
/// is present every time.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_sweep_never_removes_a_blob_just_stored_by_an_upload() {
    let f = playing(USABLE).await;
    let (blobs, content) = (f.ingest.blobs().clone(), b"pushed again and again");
    let (store, removed_from, sought) = (f.store.clone(), blobs.clone(), BlobId::from(blake3::hash(content)));
    let stop = tokio_util::sync::CancellationToken::new();
    let stopped = stop.clone();
    let removing = tokio::spawn(async move {
        let mut removed = 0_u32;
        while !stopped.is_cancelled() {
            removed += u32::from(forget(&store, &removed_from, &sought).await.unwrap().is_some());
            tokio::task::yield_now().await;
        }
        removed
    });
    for _ in 0..50 {
        let episode = f.push(content).await.unwrap().episode;
        assert_eq!(blobs.get(&episode.recording).unwrap(), content, "acknowledged content is present");
        f.store.delete_episodes(std::slice::from_ref(&episode.id), false).await.unwrap();
        f.store.sweep_trash(crate::domain::time::Millis(i64::MAX)).await.unwrap();
    }
    stop.cancel();
    assert!(removing.await.unwrap() > 0, "the two tasks overlapped");
}

/// Files without recent writes, and older than every running attempt.
#[tokio::test]
async fn leftovers_of_killed_workers_are_removed() {
    let lab = lab().await;
    let (sweeper, tmp) = (sweeper(&lab, 30), lab.dir.path().join("tmp"));
    fs::create_dir_all(tmp.join("export")).unwrap();
    fs::write(tmp.join("export/half.mcap"), b"half").unwrap();
    fs::write(tmp.join("blob-x"), b"half").unwrap();
    assert_eq!(sweeper.sweep(SystemTime::now()).await.unwrap().leavings, 0, "too young");
    // A file in it is being written.
    let file = fs::File::options().write(true).open(tmp.join("export/half.mcap")).unwrap();
    file.set_modified(in_days(2)).unwrap();
    assert_eq!(sweeper.sweep(in_days(2)).await.unwrap().leavings, 1);
    assert_eq!(sweeper.sweep(in_days(4)).await.unwrap().leavings, 1);
    assert!(fs::read_dir(&tmp).unwrap().next().is_none());
}

/// Logs of jobs are kept for long; a job's page works without them.
#[tokio::test]
async fn logs_unused_for_long_are_removed() {
    let lab = lab().await;
    let (sweeper, logs) = (sweeper(&lab, 30), lab.dir.path().join("logs"));
    fs::create_dir_all(&logs).unwrap();
    let [quiet, newer] = ["a.log", "b.log"].map(|name| logs.join(name));
    fs::write(&quiet, b"line").unwrap();
    fs::write(&newer, b"line").unwrap();
    fs::File::options().write(true).open(&newer).unwrap().set_modified(in_days(80)).unwrap();
    assert_eq!(sweeper.sweep(in_days(89)).await.unwrap().logs, 0);
    assert_eq!(sweeper.sweep(in_days(91)).await.unwrap().logs, 1);
    assert!(newer.exists() && !quiet.exists());
    assert_eq!(sweeper.sweep(in_days(171)).await.unwrap().logs, 1);
}

#[tokio::test]
async fn the_audit_log_is_kept_for_the_configured_time() {
    let lab = lab().await;
    let mut sweeper = sweeper(&lab, 30);
    let entry = |days| AuditEntry {
        at: Millis::of(SystemTime::now() - DAY * days),
        token_id: None,
        caller: "anna".into(),
        peer: "10.0.0.7:9".into(),
        rpc: "TaskService/CreateTask".into(),
        subjects: Vec::new(),
        outcome: "ok".into(),
    };
    let (old, new) = (entry(31), entry(29));
    for entry in [&old, &new] {
        lab.store.insert_audit(entry).await.unwrap();
    }
    assert_eq!(sweeper.sweep(SystemTime::now()).await.unwrap(), SweepCounts::default(), "no limit is set");
    sweeper.maintenance.audit_days = Some(30);
    assert_eq!(sweeper.sweep(SystemTime::now()).await.unwrap(), SweepCounts { audited: 1, ..SweepCounts::default() });
    assert_eq!(lab.store.audit(Millis(0), 10).await.unwrap(), [new]);
}
