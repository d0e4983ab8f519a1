//! The files of exports are kept for `--keep-exports-days`.

use std::fs;

use super::{
    super::sweep::SweepCounts,
    sweeping::{in_days, sweeper},
    *,
};
use crate::{
    domain::{dataset::ExportFile, id::ExportId, selection::Selection},
    error::Kind,
};

/// A finished export with these files.
async fn exported(lab: &Lab, contents: &[&[u8]]) -> (ExportId, Vec<BlobId>) {
    let encoder = results::encoder(&lab.store, &lab.task).await;
    results::set_state(&lab.store, &encoder.job_id, crate::domain::job::JobState::Succeeded, "").await;
    let run = results::run(&lab.store, &lab.task, &encoder, &[]).await;
    let dataset = lab.store.insert_dataset(&run.id, Selection::beta(0.5)).await.unwrap().id;
    let blobs: Vec<BlobId> = contents.iter().map(|content| lab.blobs.put(content).unwrap()).collect();
    let files = contents.iter().zip(&blobs).enumerate().map(|(place, (content, blob))| ExportFile {
        name: format!("{place}.mcap"),
        blob: blob.clone(),
        size_bytes: content.len() as u64,
    });
    let files: Vec<ExportFile> = files.collect();
    (results::export(&lab.store, &lab.task, &dataset, &files).await, blobs)
}

/// MCAP files, which a sweep would keep as recordings, and more of them than it may move to the trash.
#[tokio::test]
async fn files_of_exports_are_removed_after_their_days() {
    let lab = lab().await;
    let sweeper = sweeper(&lab, 90);
    let contents: Vec<Vec<u8>> = (0..20).map(|number| [b"\x89MCAP0\r\n".as_slice(), &[number]].concat()).collect();
    let contents: Vec<&[u8]> = contents.iter().map(Vec::as_slice).collect();
    let (export, blobs) = exported(&lab, &contents).await;
    assert_eq!(sweeper.sweep(in_days(29)).await.unwrap().blobs, 0);
    assert_eq!(lab.store.export_files(&export).await.unwrap().len(), 20);
    let counts = sweeper.sweep(in_days(31)).await.unwrap();
    assert_eq!((counts.blobs, counts.bytes, counts.trashed), (20, 180, 0));
    assert!(!blobs.iter().any(|blob| lab.blobs.contains(blob)) && lab.blobs.list_trash().unwrap().is_empty());
    assert!(lab.blobs.contains(&lab.recording) && lab.blobs.contains(&lab.checkpoint));
    assert_eq!(lab.store.export_files(&export).await.unwrap_err().kind(), Kind::Precondition);
    let findings = checked(lab.dir.path(), false).await.findings;
    assert!(findings.iter().all(|found| !format!("{found:?}").contains(export.as_str())), "{findings:?}");
}

#[tokio::test]
async fn content_that_another_row_needs_stays() {
    let lab = lab().await;
    let sweeper = sweeper(&lab, 90);
    let (export, blobs) = exported(&lab, &[b"failure", b"encoder", b"own"]).await;
    assert_eq!(sweeper.sweep(in_days(31)).await.unwrap().blobs, 1);
    assert_eq!(blobs.iter().map(|blob| lab.blobs.contains(blob)).collect::<Vec<_>>(), [true, true, false]);
    assert_eq!(lab.store.export_files(&export).await.unwrap_err().kind(), Kind::Precondition);
}

/// As by an equal export that is being made, by a restored backup, or by the first start with a bucket: no sweep finds files
/// without a row, and a later one removes them.
#[tokio::test]
async fn an_export_with_a_file_that_was_stored_lately_stays_whole() {
    let lab = lab().await;
    let sweeper = sweeper(&lab, 90);
    let (export, blobs) = exported(&lab, &[b"\x89MCAP0\r\n1", b"\x89MCAP0\r\n2"]).await;
    fs::File::open(lab.blobs.path(&blobs[1])).unwrap().set_modified(in_days(31)).unwrap();
    assert_eq!(sweeper.sweep(in_days(31)).await.unwrap(), SweepCounts::default());
    assert_eq!(lab.store.export_files(&export).await.unwrap().len(), 2);
    let counts = sweeper.sweep(in_days(33)).await.unwrap();
    assert_eq!((counts.blobs, counts.trashed), (2, 0));
}

/// A sweep that ended between the files and their rows.
#[tokio::test]
async fn a_sweep_continues_an_interrupted_one() {
    let lab = lab().await;
    let sweeper = sweeper(&lab, 90);
    let (_, blobs) = exported(&lab, &[b"\x89MCAP0\r\n1", b"\x89MCAP0\r\n2"]).await;
    let removing = lab.blobs.removing().await.unwrap().unwrap();
    lab.blobs.remove(&blobs[0], &removing).unwrap();
    drop(removing);
    assert_eq!(sweeper.sweep(in_days(31)).await.unwrap().blobs, 1);
    assert_eq!(sweeper.sweep(in_days(31)).await.unwrap(), SweepCounts::default());
    assert!(checked(lab.dir.path(), false).await.findings.iter().all(|found| !format!("{found:?}").contains("exp_")));
}

#[tokio::test]
async fn the_key_of_a_forgotten_export_is_free_again() {
    let lab = lab().await;
    let (export, _) = exported(&lab, &[b"own"]).await;
    let job = lab.store.job_of_result(export.as_str()).await.unwrap().unwrap();
    results::set_key(&lab.store, &job.id, "nightly").await;
    sweeper(&lab, 90).sweep(in_days(31)).await.unwrap();
    assert!(lab.store.job_of_key(&lab.task.id, "nightly").await.unwrap().is_none());
}

#[tokio::test]
async fn exports_stay_while_the_folder_is_copied_and_without_a_limit() {
    let lab = lab().await;
    let mut sweeper = sweeper(&lab, 90);
    let (export, _) = exported(&lab, &[b"steps"]).await;
    let copying = crate::blobs::Copying::begin(lab.dir.path()).unwrap();
    sweeper.sweep(in_days(31)).await.unwrap();
    drop(copying);
    sweeper.maintenance.export_days = 0;
    sweeper.sweep(in_days(999)).await.unwrap();
    assert_eq!(lab.store.export_files(&export).await.unwrap().len(), 1);
}
