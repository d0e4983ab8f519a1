//! Uploads: which data is kept, and the effects of crashes and hostile recordings.

use std::{
    fs,
    time::{Duration, Instant},
};

use futures::{StreamExt as _, stream};
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;

use super::{
    Started, part_path,
    testing::{Fixture, REFUSING, USABLE, child, chunk, playing, real, recording},
};
use crate::{
    domain::{
        attempt::AttemptEnd,
        episode::{EpisodeFilter, NewUpload, Outcome},
        id::UploadId,
        placement::Placement,
    },
    error::{Error, Kind},
    store::testing::claimed,
};

#[tokio::test]
async fn an_upload_becomes_an_episode() {
    let f = playing(USABLE).await;
    let inspected = f.push(b"recording").await.unwrap();
    let episode = f.store.episode(&inspected.episode.id).await.unwrap().episode;
    assert_eq!((episode.steps, episode.mapping.as_str(), episode.cohort.as_str()), (20, "plain", "ada"));
    assert_eq!(f.ingest.blobs.get(&episode.recording).unwrap(), b"recording");
    assert_eq!(f.store.labels(&episode.id).await.unwrap()[0].author, "tests");
    assert!(f.files(&["uploads", "tmp"]).is_empty(), "{:?}", f.files(&["uploads", "tmp"]));
    assert!(f.store.uploads().await.unwrap().is_empty());
}

/// Lost by the disk or an operator: the answer "it exists" would lose the last copy.
#[tokio::test]
async fn a_recording_whose_blob_is_missing_can_be_pushed_again() {
    let f = playing(USABLE).await;
    let first = f.push(b"recording").await.unwrap().episode;
    fs::remove_file(f.ingest.blobs.path(&first.recording)).unwrap();
    let again = f.push(b"recording").await.unwrap().episode;
    assert_eq!(again.id, first.id, "it is the same episode");
    assert_eq!(f.ingest.blobs.get(&first.recording).unwrap(), b"recording");
    assert_eq!(f.ingest.blobs.descriptions(&first.recording).unwrap().len(), 1);
    fs::write(f.ingest.blobs.path(&first.recording), b"rec").unwrap();
    assert_eq!(f.push(b"recording").await.unwrap().episode.id, first.id);
    assert_eq!(f.ingest.blobs.get(&first.recording).unwrap(), b"recording", "a cut one is as good as lost");
}

/// A quota, say, that the disk reports at the sync alone: the device that takes every byte has nothing to sync to.
#[tokio::test]
async fn a_failed_sync_leaves_the_upload_at_its_acknowledged_bytes() {
    let f = playing(USABLE).await;
    let upload = f.start(b"recording").await;
    let path = part_path(f.dir.path(), &upload.id);
    fs::remove_file(&path).unwrap();
    std::os::unix::fs::symlink("/dev/null", &path).unwrap();
    let error = f.write(&upload.id, 0, b"recording").await.unwrap_err();
    assert!(error.kind() != Kind::NotFound, "{error}");
    assert_eq!(f.ingest.status(&upload.id).await.unwrap().committed, 0);

    fs::remove_file(&path).unwrap();
    fs::write(&path, b"").unwrap();
    assert_eq!(f.write(&upload.id, 0, b"recording").await.unwrap(), 9);
    let inspected = f.ingest.finish(&upload.id).await.unwrap();
    assert_eq!(f.ingest.blobs.get(&inspected.episode.recording).unwrap(), b"recording");
}

#[tokio::test]
async fn a_broken_stream_is_resumed_after_a_restart() {
    let mut f = playing(USABLE).await;
    let upload = f.start(b"recording").await;
    let broken = stream::iter([Ok(chunk(&upload.id, 0, b"reco")), Err(Error::cancelled("gone"))]);
    assert_eq!(f.ingest.write(broken).await.unwrap_err().kind(), Kind::Cancelled);
    assert_eq!(f.ingest.status(&upload.id).await.unwrap().committed, 4);

    f.reopen().await;
    let again = f.start(b"recording").await;
    assert_eq!((&again.id, again.committed), (&upload.id, 4));
    let early = f.ingest.finish(&upload.id).await.unwrap_err();
    assert_eq!(early.kind(), Kind::Precondition);
    assert!(early.message().contains("4 of 9 bytes"), "{early}");
    assert_eq!(f.write(&upload.id, 4, b"rding").await.unwrap(), 9);
    let inspected = f.ingest.finish(&upload.id).await.unwrap();
    assert_eq!(f.ingest.blobs.get(&inspected.episode.recording).unwrap(), b"recording");
}

#[tokio::test]
async fn bytes_are_acknowledged_while_the_stream_is_open() {
    let f = playing(USABLE).await;
    let upload = f.start(b"recording").await;
    let (send, chunks) = mpsc::channel(1);
    let writing = f.ingest.write(ReceiverStream::new(chunks));
    let watching = async {
        send.send(Ok(chunk(&upload.id, 0, b"reco"))).await.unwrap();
        until_committed(&f, &upload.id).await;
        drop(send);
    };
    let (committed, ()) = tokio::join!(writing, watching);
    assert_eq!(committed.unwrap(), 4);
}

/// Waits until some bytes are acknowledged while their stream is open.
async fn until_committed(f: &Fixture, id: &UploadId) {
    let deadline = Instant::now() + Duration::from_secs(60);
    while f.ingest.status(id).await.unwrap().committed == 0 {
        assert!(Instant::now() < deadline, "no byte was acknowledged");
        tokio::task::yield_now().await;
    }
}

#[tokio::test]
async fn a_wrong_chunk_is_refused_and_earlier_chunks_are_kept() {
    let f = playing(USABLE).await;
    let upload = f.start(b"recording").await;
    for (at, last, field, committed) in [
        (0, chunk(&upload.id, 4, b"x"), "offset: ", 2),
        (2, chunk(&upload.id, 4, b"rding!"), "data: ", 4),
        (4, chunk(&UploadId::new(), 6, b"ing"), "upload_id: ", 6),
    ] {
        let chunks = stream::iter([Ok(chunk(&upload.id, at, &b"recording"[at..at + 2])), Ok(last)]);
        let error = f.ingest.write(chunks).await.unwrap_err();
        assert!(error.message().starts_with(field), "{error}");
        assert_eq!(f.ingest.status(&upload.id).await.unwrap().committed, committed);
    }
    let nothing = f.ingest.write(stream::empty().boxed()).await.unwrap_err();
    assert!(nothing.message().starts_with("upload_id: "), "{nothing}");
    assert_eq!(f.write(&UploadId::new(), 0, b"r").await.unwrap_err().kind(), Kind::NotFound);
}

#[tokio::test]
async fn a_new_stream_takes_over_from_one_that_hangs() {
    let f = playing(USABLE).await;
    let upload = f.start(b"recording").await;
    let (send, chunks) = mpsc::channel(1);
    let ingest = f.ingest.clone();
    let hanging = tokio::spawn(async move { ingest.write(ReceiverStream::new(chunks)).await });
    send.send(Ok(chunk(&upload.id, 0, b"reco"))).await.unwrap();
    until_committed(&f, &upload.id).await;
    let refused = f.write(&upload.id, 0, b"recording").await.unwrap_err();
    assert!(refused.message().starts_with("offset: "), "{refused}");
    assert_eq!(hanging.await.unwrap().unwrap_err().kind(), Kind::Unavailable);
    assert_eq!(f.ingest.status(&upload.id).await.unwrap().committed, 4);
    assert_eq!(f.write(&upload.id, 4, b"rding").await.unwrap(), 9);
}

#[tokio::test]
async fn the_same_content_twice_is_the_same_episode() {
    let f = playing(USABLE).await;
    let one = f.start(b"recording").await;
    let two = f.beside(&one).await;
    for upload in [&one, &two] {
        f.write(&upload.id, 0, b"recording").await.unwrap();
    }
    let (first, second) = tokio::join!(f.ingest.finish(&one.id), f.ingest.finish(&two.id));
    let id = first.unwrap().episode.id;
    assert_eq!(second.unwrap().episode.id, id);
    let Started::Existing(third) = f.ingest.start(f.new_upload(b"recording")).await.unwrap() else {
        panic!("opened again")
    };
    assert_eq!(third.id, id);
    let filter = EpisodeFilter { task_id: f.task.id.clone(), outcome: None, cohort: None, deleted: false };
    assert_eq!(f.store.episodes(&filter, None, 9).await.unwrap().0.len(), 1);
    assert!(f.files(&["uploads", "tmp"]).is_empty());
}

#[tokio::test]
async fn equal_content_under_another_label_is_an_error_with_its_label() {
    let f = playing(USABLE).await;
    let early = f.start(b"recording").await;
    let late = f.beside(&crate::domain::episode::Upload { cohort: "bob".into(), ..early.clone() }).await;
    for upload in [&late, &early] {
        f.write(&upload.id, 0, b"recording").await.unwrap();
    }
    let id = f.ingest.finish(&early.id).await.unwrap().episode.id;
    let other = NewUpload { outcome: Outcome::Failure, ..f.new_upload(b"recording") };
    let error = f.ingest.start(other).await.unwrap_err();
    assert_eq!(error.kind(), Kind::Exists);
    for part in [id.as_str(), "labelled success", "\"ada\"", "gleaner label"] {
        assert!(error.message().contains(part), "{error}");
    }
    // Also when the content became visible while an upload was open.
    assert_eq!(f.ingest.finish(&late.id).await.unwrap_err().kind(), Kind::Exists);
    assert!(f.files(&["uploads"]).is_empty());
}

#[tokio::test]
async fn a_rejected_recording_is_not_kept() {
    let f = playing(REFUSING).await;
    let error = f.push(b"recording").await.unwrap_err();
    assert_eq!(error.kind(), Kind::Invalid);
    assert_eq!(error.message(), "recording: reach.mcap holds no /joints; record it");
    assert!(f.store.uploads().await.unwrap().is_empty());
    assert!(f.files(&["uploads", "blobs", "cache", "tmp"]).is_empty());
}

#[tokio::test]
async fn content_that_differs_from_its_declaration_is_not_stored() {
    let f = playing(USABLE).await;
    let upload = f.start(b"recording").await;
    f.write(&upload.id, 0, b"recordinG").await.unwrap();
    let error = f.ingest.finish(&upload.id).await.unwrap_err();
    assert!(error.message().starts_with("blake3: "), "{error}");
    assert_eq!(f.ingest.status(&upload.id).await.unwrap_err().kind(), Kind::NotFound);
    assert!(f.files(&["uploads", "blobs"]).is_empty());
}

#[tokio::test]
async fn a_failed_inspection_keeps_the_upload() {
    let f = playing("echo no such library >&2; exit 127").await;
    let upload = f.start(b"recording").await;
    f.write(&upload.id, 0, b"recording").await.unwrap();
    let error = f.ingest.finish(&upload.id).await.unwrap_err();
    assert_eq!(error.kind(), Kind::Internal);
    assert!(error.to_string().contains("no such library"), "{error}");
    assert_eq!(f.ingest.status(&upload.id).await.unwrap().committed, 9);
}

#[tokio::test]
async fn a_recording_above_the_limit_is_rejected_before_the_first_byte() {
    let f = real("none", &["--max-upload-bytes", "8"]).await;
    assert_eq!(f.ingest.start(f.new_upload(b"recording")).await.unwrap_err().kind(), Kind::Exhausted);
}

#[tokio::test]
async fn a_start_recovers_uploads_after_a_crash() {
    let mut f = playing(USABLE).await;
    let dir = f.dir.path().to_owned();
    let (longer, shorter, gone, placed) =
        (f.start(b"longer").await, f.start(b"shorter").await, f.start(b"gone").await, f.start(b"placed").await);
    f.write(&longer.id, 0, b"long").await.unwrap();
    fs::write(part_path(&dir, &longer.id), b"long, with bytes that were never synced").unwrap();
    f.write(&shorter.id, 0, b"short").await.unwrap();
    fs::write(part_path(&dir, &shorter.id), b"sh").unwrap();
    f.write(&gone.id, 0, b"gone").await.unwrap();
    fs::remove_file(part_path(&dir, &gone.id)).unwrap();
    // The crash came between the move of a finished upload and its row.
    f.write(&placed.id, 0, b"placed").await.unwrap();
    f.ingest.blobs.put_file(&part_path(&dir, &placed.id)).unwrap();
    fs::write(part_path(&dir, &UploadId::new()), b"no row").unwrap();
    fs::write(dir.join("cache/abc-0123.frames"), b"whole").unwrap();

    f.reopen().await;
    let open: Vec<_> = f.store.uploads().await.unwrap().into_iter().map(|upload| upload.id).collect();
    assert_eq!(open.len(), 2);
    assert!(open.contains(&longer.id) && open.contains(&placed.id));
    assert_eq!(fs::read(part_path(&dir, &longer.id)).unwrap(), b"long");
    assert_eq!(f.files(&["uploads", "cache"]), [dir.join("cache/abc-0123.frames"), part_path(&dir, &longer.id)]);
    assert_eq!(f.write(&longer.id, 4, b"er").await.unwrap(), 6);
    assert!(f.ingest.finish(&placed.id).await.is_ok());
    assert_eq!(f.ingest.blobs.get(&placed.blake3).unwrap(), b"placed");
}

/// Workers on other machines write there while the server is down.
#[tokio::test]
async fn a_start_leaves_the_files_of_workers_that_outlive_a_server() {
    let mut f = playing(USABLE).await;
    let left = ["tmp/export-x", "tmp/blob-x", "cache/abc-0123.frames.7-0.partial"].map(|name| f.dir.path().join(name));
    let place = || {
        fs::create_dir_all(&left[0]).unwrap();
        left[1..].iter().for_each(|path| fs::write(path, b"half").unwrap());
    };
    for (engine, stay) in [("slurm", true), (Placement::LOCAL, false)] {
        let attempt = claimed(&f.store, &f.task.id, engine).await;
        place();
        f.reopen().await;
        assert_eq!(left.each_ref().map(|path| path.exists()), [stay; 3], "{engine}");
        f.store.end_attempt(&attempt, &AttemptEnd::Permanent("no more".into())).await.unwrap();
    }
}

/// The sharing of inspections between clients, and the limit on open uploads.
mod callers;
/// Recordings read, rejected and stopped by a real inspection.
mod inspected;
