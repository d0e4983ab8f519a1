//! A nearly full disk refuses new data; received bytes are kept, and uploads resume when there is room.

use std::sync::{
    Arc,
    atomic::{AtomicU64, Ordering},
};

use bytes::Bytes;
use futures::{Stream, StreamExt as _, stream};

use super::*;
use crate::domain::episode::Outcome;
use crate::ingest::{
    Chunk, Declared,
    testing::{USABLE, playing},
};

#[tokio::test]
async fn an_upload_waits_for_room_and_resumes() {
    let mut f = playing(USABLE).await;
    let free = f.on_a_small_disk();
    let content = b"a recording of some bytes";
    free.store(100 + content.len() as u64 - 1, Ordering::Relaxed);
    let error = f.ingest.start(f.new_upload(content)).await.unwrap_err();
    assert!(error.kind() == Kind::Exhausted && error.message().contains("--min-free-bytes"), "{error}");
    assert!(f.store.uploads().await.unwrap().is_empty() && f.files(&["uploads"]).is_empty(), "no file is left");

    free.store(100 + content.len() as u64, Ordering::Relaxed);
    let upload = f.start(content).await;
    assert_eq!(f.write(&upload.id, 0, &content[..9]).await.unwrap(), 9);
    free.store(99, Ordering::Relaxed);
    assert_eq!(f.write(&upload.id, 9, &content[9..]).await.unwrap_err().kind(), Kind::Exhausted);
    assert_eq!(f.ingest.status(&upload.id).await.unwrap().committed, 9, "acknowledged bytes stay");
    free.store(u64::MAX, Ordering::Relaxed);
    f.write(&upload.id, 9, &content[9..]).await.unwrap();
    free.store(0, Ordering::Relaxed);
    assert_eq!(f.ingest.finish(&upload.id).await.unwrap_err().kind(), Kind::Exhausted);
    free.store(u64::MAX, Ordering::Relaxed);
    let stored = f.ingest.finish(&upload.id).await.unwrap().episode;
    // Existing content takes no room.
    free.store(0, Ordering::Relaxed);
    assert!(
        matches!(f.ingest.start(f.new_upload(content)).await.unwrap(), Started::Existing(same) if same.id == stored.id)
    );
}

/// Several clients that push at once are refused before their first byte, not in the middle.
#[tokio::test]
async fn an_upload_needs_room_beside_those_in_progress() {
    let mut f = playing(USABLE).await;
    let free = f.on_a_small_disk();
    free.store(100 + 2 * 9 - 1, Ordering::Relaxed);
    let first = f.start(b"recording").await;
    let error = f.ingest.start(f.new_upload(b"the other")).await.unwrap_err();
    assert_eq!(error.kind(), Kind::Exhausted);
    for part in ["would take 18", "uploads in progress are to take 9", "100 must stay free (--min-free-bytes)"] {
        assert!(error.message().contains(part), "{part}: {error}");
    }
    f.write(&first.id, 0, b"r").await.unwrap();
    assert!(f.ingest.start(f.new_upload(b"the other")).await.is_ok(), "its client has left");
}

/// Pieces of an endless recording; the disk fills up when the n-th is polled.
fn filling(free: &Arc<AtomicU64>, n: usize) -> impl Stream<Item = Bytes> {
    let (free, piece) = (Arc::clone(free), Bytes::from(vec![7; 1 << 20]));
    stream::iter(1..).map(move |at| {
        if at == n {
            free.store(99, Ordering::Relaxed);
        }
        piece.clone()
    })
}

#[tokio::test]
async fn a_stream_that_fills_the_disk_ends_soon_after() {
    let mut f = playing(USABLE).await;
    let free = f.on_a_small_disk();
    let upload = f.start(&vec![7; 64 << 20]).await;
    let id = upload.id.clone();
    let chunks = filling(&free, 4).enumerate().map(move |(at, data)| {
        let (upload_id, offset) = (Some(id.clone()), (at as u64) << 20);
        Ok(Chunk { upload_id, offset, data })
    });
    assert_eq!(f.ingest.write(chunks).await.unwrap_err().kind(), Kind::Exhausted);
    let committed = f.ingest.status(&upload.id).await.unwrap().committed;
    assert!((4 << 20..=6 << 20).contains(&committed), "{committed}");
}

#[tokio::test]
async fn an_inspected_recording_needs_room_even_if_it_is_not_stored() {
    let mut f = playing(USABLE).await;
    let free = f.on_a_small_disk();
    for n in [1, 9] {
        free.store(if n == 1 { 99 } else { u64::MAX }, Ordering::Relaxed);
        let chunks = filling(&free, n).map(Ok);
        let error = f.ingest.pass(&Client::Server, &f.task.spec, Declared::default(), chunks).await.unwrap_err();
        assert!(error.message().contains("--min-free-bytes"), "{error}");
        assert!(f.files(&["tmp"]).is_empty());
    }
}

/// A client that pushes the same file with another label gets its own upload; the first one to finish decides.
#[tokio::test]
async fn an_upload_is_not_offered_to_another_label() {
    let f = playing(USABLE).await;
    let mine = f.start(b"recording").await;
    f.write(&mine.id, 0, b"reco").await.unwrap();
    for other in [
        NewUpload { outcome: Outcome::Failure, ..f.new_upload(b"recording") },
        NewUpload { cohort: "bob".into(), ..f.new_upload(b"recording") },
    ] {
        let Started::Open(theirs) = f.ingest.start(other).await.unwrap() else { panic!("no episode exists") };
        assert!(theirs.id != mine.id && theirs.committed == 0);
        assert_eq!(f.ingest.status(&mine.id).await.unwrap().outcome, Outcome::Success, "the label stays");
        f.write(&theirs.id, 0, b"recording").await.unwrap();
    }
    assert_eq!(f.start(b"recording").await.id, mine.id);
    f.write(&mine.id, 4, b"rding").await.unwrap();
    let stored = f.ingest.finish(&mine.id).await.unwrap().episode;
    assert_eq!((stored.outcome, stored.cohort.as_str()), (Outcome::Success, "ada"));
    for late in f.store.uploads().await.unwrap() {
        assert_eq!(f.ingest.finish(&late.id).await.unwrap_err().kind(), Kind::Exists);
    }
}
