//! A lost database loses history and never recordings.

use std::fs;

use super::{
    sweeping::{in_days, stored, sweeper},
    *,
};
use crate::{
    config::{DatabaseConfig, RebuildConfig},
    data_folder,
    domain::episode::{Episode, NewLabel},
    maintenance::{describe::describe_queued, rebuild::rebuild},
    store::Database,
};

async fn rebuilt(dir: &Path) -> (bool, String) {
    let mut out = Vec::new();
    let config = RebuildConfig { data_dir: dir.to_owned(), fast: false, database: DatabaseConfig::default() };
    let sound = rebuild(&config, &mut out).await.unwrap();
    (sound, String::from_utf8(out).unwrap())
}

/// A lab whose rows are all described, and its episodes: the newest one is deleted, the one before is labelled.
async fn described() -> (Lab, Vec<Episode>) {
    let lab = lab().await;
    let (labelled, deleted) = (stored(&lab, b"labelled later").await, stored(&lab, b"deleted").await);
    let label = NewLabel {
        outcome: Some(Outcome::Failure),
        cohort: Some("night".into()),
        author: "ada".into(),
        reason: "it slipped".into(),
    };
    lab.store.label_episodes(std::slice::from_ref(&labelled.id), &label).await.unwrap();
    lab.store.delete_episodes(std::slice::from_ref(&deleted.id), false).await.unwrap();
    describe_queued(&lab.store, &lab.blobs).await.unwrap();
    (lab, vec![labelled, deleted])
}

async fn reopen(dir: &Path) -> Store {
    Store::open_with_blobs(&Database::in_folder(dir), &Blobs::open(dir).unwrap(), false).await.unwrap()
}

#[tokio::test]
async fn a_lost_database_is_rebuilt_with_tasks_labels_and_trash() {
    let (lab, episodes) = described().await;
    let (dir, task, before) = (lab.dir, lab.task, lab.store.episode(&episodes[0].id).await.unwrap());
    lab.store.close().await;
    for suffix in ["", "-wal", "-shm"] {
        let _ = fs::remove_file(data_folder::beside_database(dir.path(), suffix));
    }
    let (sound, text) = rebuilt(dir.path()).await;
    // The checkpoint of the encoder and the policy is one blob, which no restored row can name.
    assert!(!sound && text.contains("1 tasks and 4 episodes") && text.contains("1 blobs unclaimed"), "{text}");
    let store = reopen(dir.path()).await;
    assert_eq!(store.task(&task.spec.name).await.unwrap().id, task.id);
    let after = store.episode(&episodes[0].id).await.unwrap();
    assert_eq!((after.episode.outcome, after.episode.cohort.as_str()), (Outcome::Failure, "night"));
    assert_eq!((after.report, after.episode.steps), (before.report, before.episode.steps));
    assert_eq!(store.labels(&episodes[0].id).await.unwrap()[0].author, "ada");
    assert!(store.episode(&episodes[1].id).await.unwrap().episode.deleted_at.is_some());
    let unclaimed: Vec<_> = fs::read_dir(dir.path().join("unclaimed")).unwrap().collect();
    assert_eq!(unclaimed.len(), 3, "the checkpoint and its two descriptions");
}

#[tokio::test]
async fn an_older_database_is_completed_and_keeps_its_history() {
    let (lab, episodes) = described().await;
    lab.store.close().await;
    let dir = lab.dir;
    let older = fs::read(data_folder::database(dir.path())).unwrap();
    let store = reopen(dir.path()).await;
    let again = Lab { store: store.clone(), blobs: lab.blobs.clone(), task: lab.task, dir, ..lab };
    let newer = stored(&again, b"after the copy").await;
    describe_queued(&store, &again.blobs).await.unwrap();
    store.close().await;
    let dir = again.dir.path();
    fs::write(data_folder::database(dir), older).unwrap();
    assert!(Store::open_with_blobs(&Database::in_folder(dir), &again.blobs, false).await.is_err());
    let (sound, text) = rebuilt(dir).await;
    assert!(sound && text.contains("0 tasks and 1 episodes"), "{text}");
    let store = reopen(dir).await;
    assert!(store.episode(&newer.id).await.is_ok());
    assert_eq!(store.labels(&episodes[0].id).await.unwrap().len(), 2, "the history that there was");
}

#[tokio::test]
async fn a_damaged_database_and_one_of_another_folder_are_set_aside() {
    let (lab, _) = described().await;
    lab.store.close().await;
    let other = tempfile::tempdir().unwrap();
    let store = reopen(other.path()).await;
    let task = testing::task(&store).await;
    testing::episode(&store, &task, Outcome::Success, "").await;
    store.close().await;
    for content in [vec![7; 9000], fs::read(data_folder::database(other.path())).unwrap()] {
        fs::write(data_folder::database(lab.dir.path()), &content).unwrap();
        let (_, text) = rebuilt(lab.dir.path()).await;
        assert!(text.contains("the previous database is now") && text.contains("4 episodes"), "{text}");
    }
}

/// After an update was undone: the database has more than the sidecars.
#[tokio::test]
async fn the_database_of_a_newer_program_is_refused_and_left_in_its_place() {
    let (lab, _) = described().await;
    let newer = crate::store::newest_schema() + 5;
    testing::run(
        &lab.store,
        &format!(
            "insert into _sqlx_migrations (version, description, success, checksum, execution_time) \
             values ({newer}, 'later', true, x'00', 0)"
        ),
    )
    .await;
    lab.store.close().await;
    let path = data_folder::database(lab.dir.path());
    let before = fs::read(&path).unwrap();
    let config = RebuildConfig { data_dir: lab.dir.path().to_owned(), fast: true, database: DatabaseConfig::default() };
    let error = rebuild(&config, &mut Vec::new()).await.unwrap_err();
    assert_eq!(error.kind(), crate::error::Kind::Precondition, "{error}");
    for part in [newer, crate::store::newest_schema()] {
        assert!(error.message().contains(&part.to_string()), "{error}");
    }
    assert!(fs::read(&path).unwrap() == before, "the database is where it was");
}

#[tokio::test]
async fn an_undeleted_recording_in_the_trash_is_restored() {
    let (lab, episodes) = described().await;
    for table in ["labels where episode_id", "episodes where id"] {
        testing::run(&lab.store, &format!("delete from {table} = '{}'", episodes[0].id)).await;
    }
    sweeper(&lab, 30).sweep(in_days(2)).await.unwrap();
    assert!(!lab.blobs.contains(&episodes[0].recording));
    lab.store.close().await;
    let (_, text) = rebuilt(lab.dir.path()).await;
    assert!(text.contains("1 episodes; ") && text.contains("1 blobs restored"), "{text}");
    assert!(lab.blobs.contains(&episodes[0].recording));
    assert!(reopen(lab.dir.path()).await.episode(&episodes[0].id).await.is_ok());
}

#[tokio::test]
async fn damaged_recordings_and_those_without_a_description_are_kept_aside() {
    let (lab, episodes) = described().await;
    lab.store.close().await;
    fs::write(lab.blobs.path(&episodes[0].recording), b"labelled lateX").unwrap();
    let undescribed = lab.blobs.put(b"\x89MCAP0\r\nsteps").unwrap();
    fs::remove_file(data_folder::database(lab.dir.path())).unwrap();
    let (sound, text) = rebuilt(lab.dir.path()).await;
    assert!(!sound && text.contains("is damaged") && text.contains("push it again"), "{text}");
    assert!(lab.dir.path().join(format!("unclaimed/{undescribed}.mcap")).is_file());
    assert_eq!(
        fs::read(lab.dir.path().join(format!("unclaimed/{}.blob", episodes[0].recording))).unwrap(),
        b"labelled lateX"
    );
}

#[tokio::test]
async fn a_folder_in_use_or_without_blobs_is_refused() {
    let (lab, _) = described().await;
    let config =
        |dir: &Path| RebuildConfig { data_dir: dir.to_owned(), fast: true, database: DatabaseConfig::default() };
    let held = crate::lock::DataLock::take(lab.dir.path()).unwrap();
    assert!(rebuild(&config(lab.dir.path()), &mut Vec::new()).await.unwrap_err().message().contains("another"));
    drop(held);
    let empty = tempfile::tempdir().unwrap();
    let error = rebuild(&config(empty.path()), &mut Vec::new()).await.unwrap_err();
    assert!(error.message().contains("holds no blobs"), "{error}");
}

/// Clients created the task again before the rebuild: with the same spec it is the same task, and another task keeps
/// the name.
#[tokio::test]
async fn a_task_created_again_takes_its_episodes_or_keeps_its_name() {
    for same in [true, false] {
        let (lab, episodes) = described().await;
        lab.store.close().await;
        fs::remove_file(data_folder::database(lab.dir.path())).unwrap();
        let store = Store::open_with_blobs(&Database::in_folder(lab.dir.path()), &lab.blobs, true).await.unwrap();
        let rate_hz = if same { testing::spec().rate_hz } else { 5.0 };
        let task = store.insert_task(&gleaner_recording::TaskSpec { rate_hz, ..testing::spec() }).await.unwrap();
        store.close().await;
        let (_, text) = rebuilt(lab.dir.path()).await;
        assert!(text.contains("4 episodes") && !text.contains("has no sidecar"), "{text}");
        let store = reopen(lab.dir.path()).await;
        let of = store.episode(&episodes[0].id).await.unwrap().episode.task_id;
        assert_eq!(of == task.id, same, "{text}");
    }
}

/// An undelete that an older copy of the database lacks.
#[tokio::test]
async fn an_undeleted_recording_stays_in_spite_of_an_older_database() {
    let (lab, episodes) = described().await;
    lab.store.close().await;
    let older = fs::read(data_folder::database(lab.dir.path())).unwrap();
    for rebuilds in [true, false] {
        let store = reopen(lab.dir.path()).await;
        store.undelete_episodes(std::slice::from_ref(&episodes[1].id)).await.unwrap();
        describe_queued(&store, &lab.blobs).await.unwrap();
        store.close().await;
        fs::write(data_folder::database(lab.dir.path()), &older).unwrap();
        assert!(Store::open_with_blobs(&Database::in_folder(lab.dir.path()), &lab.blobs, false).await.is_err());
        if rebuilds {
            assert!(rebuilt(lab.dir.path()).await.1.contains("1 episodes brought up to date"));
            assert!(reopen(lab.dir.path()).await.episode(&episodes[1].id).await.unwrap().episode.deleted_at.is_none());
            continue;
        }
        let store = Store::open_with_blobs(&Database::in_folder(lab.dir.path()), &lab.blobs, true).await.unwrap();
        let again = Lab { ingest: crate::ingest::testing::open_on(&lab.dir, &store).await, store, ..lab };
        let counts = sweeper(&again, 0).sweep(in_days(2)).await.unwrap();
        assert_eq!(counts.episodes, 1, "the row of the older copy is removed");
        sweeper(&again, 0).sweep(in_days(9)).await.unwrap();
        assert_eq!(again.blobs.list_trash().unwrap()[0].id.as_ref(), Some(&episodes[1].recording));
        return;
    }
}

/// Two tasks have one recording, and the sidecar of one is missing: the other's episode keeps its blob.
#[tokio::test]
async fn a_recording_of_two_tasks_stays_for_the_known_one() {
    let lab = lab().await;
    let episode = stored(&lab, b"shared").await;
    let other = gleaner_recording::TaskSpec { name: "other".into(), ..testing::spec() };
    let other = lab.store.insert_task(&other).await.unwrap();
    let upload = testing::upload(&other, b"shared");
    lab.store.finish_upload(&upload, &testing::inspected(&other, &upload)).await.unwrap();
    describe_queued(&lab.store, &lab.blobs).await.unwrap();
    lab.store.close().await;
    fs::remove_file(lab.dir.path().join(format!("blobs/tasks/{}.json", other.id))).unwrap();
    fs::remove_file(data_folder::database(lab.dir.path())).unwrap();
    let (sound, text) = rebuilt(lab.dir.path()).await;
    assert!(!sound && text.contains("has no sidecar"), "{text}");
    assert!(lab.blobs.contains(&episode.recording));
    assert!(reopen(lab.dir.path()).await.episode(&episode.id).await.is_ok());
}
