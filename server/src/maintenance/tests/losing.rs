//! Recordings are deleted only by a user and after the retention time of the trash, in spite of wrong databases,
//! jumping clocks and interrupted sweeps.

use std::fs;

use super::{
    sweeping::{DAY, in_days, stored, sweeper},
    *,
};
use crate::{
    domain::{description::Description, time::Millis},
    maintenance::describe::describe_queued,
    store::testing::run,
};

/// Removes the rows of an episode, as if the database were another one.
async fn delete_rows(lab: &Lab, episode: &crate::domain::episode::Episode) {
    for table in ["labels where episode_id", "episodes where id"] {
        run(&lab.store, &format!("delete from {table} = '{}'", episode.id)).await;
    }
}

#[tokio::test]
async fn a_sweep_above_the_largest_share_removes_no_recording_and_only_leavings() {
    let lab = lab().await;
    let left = lab.dir.path().join("tmp/blob-x");
    fs::create_dir_all(left.parent().unwrap()).unwrap();
    fs::write(&left, b"half").unwrap();
    let mut sweeper = sweeper(&lab, 0);
    let gone = stored(&lab, b"deleted by a person").await;
    lab.store.delete_episodes(std::slice::from_ref(&gone.id), false).await.unwrap();
    for number in 0..9_u8 {
        lab.blobs.put(&[b"\x89MCAP0\r\n".as_slice(), &[number]].concat()).unwrap();
    }
    let error = sweeper.sweep(in_days(2)).await.unwrap_err();
    for part in ["--max-sweep-share 0.05", "move 9 recordings and results", "rebuild"] {
        assert!(error.message().contains(part), "{error}");
    }
    assert!(lab.blobs.contains(&gone.recording) && lab.store.episode(&gone.id).await.is_ok());
    assert!(!left.exists(), "what killed workers left is due");
    sweeper.maintenance.max_sweep_share = 1.0;
    let counts = sweeper.sweep(in_days(2)).await.unwrap();
    assert_eq!((counts.trashed, counts.episodes, counts.blobs), (9, 1, 1));
    assert_eq!(lab.blobs.list_trash().unwrap().len(), 9);
}

#[tokio::test]
async fn an_orphan_stays_in_the_trash_for_its_days() {
    let lab = lab().await;
    let (sweeper, orphan) = (sweeper(&lab, 30), lab.blobs.put(b"of a job that died").unwrap());
    assert_eq!(sweeper.sweep(in_days(2)).await.unwrap().trashed, 1);
    assert!(!lab.blobs.contains(&orphan));
    assert_eq!(sweeper.sweep(in_days(29)).await.unwrap().blobs, 0);
    assert_eq!(lab.blobs.list_trash().unwrap()[0].id.as_ref(), Some(&orphan));
    assert_eq!(sweeper.sweep(in_days(31)).await.unwrap().blobs, 1);
    assert!(lab.blobs.list_trash().unwrap().is_empty());
}

#[tokio::test]
async fn a_recording_not_deleted_by_a_person_stays_in_the_trash() {
    let lab = lab().await;
    let (sweeper, episode) = (sweeper(&lab, 30), stored(&lab, b"acknowledged").await);
    describe_queued(&lab.store, &lab.blobs).await.unwrap();
    delete_rows(&lab, &episode).await;
    for days in [2, 40, 4000] {
        sweeper.sweep(in_days(days)).await.unwrap();
    }
    assert_eq!(lab.blobs.list_trash().unwrap()[0].id.as_ref(), Some(&episode.recording));
    let report = checked(lab.dir.path(), true).await;
    assert!(report.findings.iter().any(|found| found.detail.contains("rebuild")), "{:?}", report.findings);
}

/// A crash between the rows and the files of a sweep: the recording was deleted by a user, so it may be removed.
#[tokio::test]
async fn an_interrupted_deletion_is_completed_by_later_sweeps() {
    let lab = lab().await;
    let (sweeper, episode) = (sweeper(&lab, 0), stored(&lab, b"deleted").await);
    lab.store.delete_episodes(std::slice::from_ref(&episode.id), false).await.unwrap();
    describe_queued(&lab.store, &lab.blobs).await.unwrap();
    delete_rows(&lab, &episode).await;
    assert_eq!(sweeper.sweep(in_days(2)).await.unwrap().trashed, 1);
    assert_eq!(sweeper.sweep(in_days(3)).await.unwrap().blobs, 1);
    assert!(lab.blobs.list_trash().unwrap().is_empty() && !lab.blobs.contains(&episode.recording));
}

#[tokio::test]
async fn a_clock_that_jumps_forty_days_at_boot_empties_no_trash() {
    let lab = lab().await;
    let (sweeper, gone) = (sweeper(&lab, 30), stored(&lab, b"deleted yesterday").await);
    let upload = testing::upload(&lab.task, b"open");
    lab.store.insert_upload(&upload, None).await.unwrap();
    lab.store.delete_episodes(std::slice::from_ref(&gone.id), false).await.unwrap();
    sweeper.note_time_as_of(in_days(0), None).await;
    // The machine boots with a clock forty days ahead.
    sweeper.note_time_as_of(in_days(40), None).await;
    let counts = sweeper.sweep(in_days(40)).await.unwrap();
    assert_eq!((counts.episodes, counts.blobs, counts.trashed, counts.uploads), (0, 0, 0, 0));
    assert!(lab.blobs.contains(&gone.recording));
    for day in 41..=69 {
        sweeper.note_time_as_of(in_days(day), Some(DAY)).await;
    }
    assert_eq!(sweeper.sweep(in_days(69)).await.unwrap().episodes, 0, "twenty-nine days have passed");
    sweeper.note_time_as_of(in_days(70), Some(DAY)).await;
    sweeper.note_time_as_of(in_days(71), Some(DAY)).await;
    let counts = sweeper.sweep(in_days(71)).await.unwrap();
    assert_eq!((counts.episodes, counts.blobs), (1, 1), "the days have passed by the server's own count");
}

#[tokio::test]
async fn sidecars_follow_labels_and_deletions_and_are_removed_with_their_episode() {
    let lab = lab().await;
    let (sweeper, episode) = (sweeper(&lab, 0), stored(&lab, b"labelled").await);
    let read = || {
        let all = lab.blobs.descriptions(&episode.recording).unwrap();
        all.iter().filter_map(|json| Description::read(json)).collect::<Vec<_>>()
    };
    describe_queued(&lab.store, &lab.blobs).await.unwrap();
    assert!(read().len() == 1 && !read()[0].is_deleted_recording());
    lab.store.delete_episodes(std::slice::from_ref(&episode.id), false).await.unwrap();
    describe_queued(&lab.store, &lab.blobs).await.unwrap();
    assert!(read().len() == 1 && read()[0].is_deleted_recording());
    sweeper.sweep(in_days(1)).await.unwrap();
    assert!(read().is_empty() && lab.blobs.list_trash().unwrap().is_empty());
    assert_eq!(describe_queued(&lab.store, &lab.blobs).await.unwrap(), 0);
}

impl crate::maintenance::Sweeper {
    /// Records the clock as if it showed `now`.
    async fn note_time_as_of(&self, now: std::time::SystemTime, ran: Option<std::time::Duration>) {
        self.store.note_time(Millis::of(now), ran).await.unwrap();
    }
}

/// A deletion whose rows are removed during a copy of the folder: the recording is removed later, and sweeps continue.
#[tokio::test]
async fn deletions_during_a_long_copy_stop_no_later_sweep() {
    let lab = lab().await;
    let sweeper = sweeper(&lab, 0);
    let mut gone = Vec::new();
    for number in 0..12_u8 {
        gone.push(stored(&lab, &[b"\x89MCAP0\r\n".as_slice(), &[number]].concat()).await.id);
    }
    lab.store.delete_episodes(&gone, false).await.unwrap();
    let copying = crate::blobs::Copying::begin(lab.dir.path()).unwrap();
    let counts = sweeper.sweep(in_days(1)).await.unwrap();
    assert_eq!((counts.episodes, counts.blobs), (12, 0));
    drop(copying);
    assert_eq!(sweeper.sweep(in_days(3)).await.unwrap().trashed, 12);
    assert_eq!(sweeper.sweep(in_days(4)).await.unwrap().blobs, 12);
}

/// A recording without a description, from an earlier version, is recognised by its first bytes.
#[tokio::test]
async fn a_recording_without_a_description_stays_in_the_trash() {
    let lab = lab().await;
    let (sweeper, id) = (sweeper(&lab, 0), lab.blobs.put(b"\x89MCAP0\r\nsteps").unwrap());
    for days in [2, 40, 4000] {
        sweeper.sweep(in_days(days)).await.unwrap();
    }
    assert_eq!(lab.blobs.list_trash().unwrap()[0].id.as_ref(), Some(&id));
}

/// A database without its row was accepted for a while, and then the one that has the row was put back.
#[tokio::test]
async fn a_blob_in_the_trash_that_a_row_names_is_restored() {
    let lab = lab().await;
    let sweeper = sweeper(&lab, 0);
    for id in [&lab.checkpoint, &lab.recording] {
        let removing = lab.blobs.removing().await.unwrap().unwrap();
        lab.blobs.discard(id, &removing).unwrap();
    }
    let report = checked(lab.dir.path(), true).await;
    let restores = |found: &&crate::maintenance::report::Finding| found.detail.contains("next sweep restores it");
    assert_eq!(report.findings.iter().filter(restores).count(), 2, "{:?}", report.findings);
    assert_eq!(sweeper.sweep(in_days(40)).await.unwrap().blobs, 0);
    assert!(lab.blobs.get(&lab.checkpoint).is_ok() && lab.blobs.get(&lab.recording).is_ok());
    assert!(lab.blobs.list_trash().unwrap().is_empty() && checked(lab.dir.path(), false).await.sound);
}
