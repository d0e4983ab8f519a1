//! A disk that is nearly full takes nothing new; what came is kept, and goes on when there is room.

#![allow(clippy::unwrap_used, clippy::panic, reason = "tests only")]

use std::sync::atomic::Ordering;

use bytes::Bytes;
use futures::stream;

use super::*;
use crate::ingest::{
    Declared,
    testing::{USABLE, playing},
};

#[tokio::test]
async fn an_upload_waits_for_room_and_goes_on() {
    let mut f = playing(USABLE).await;
    let free = f.on_a_small_disk();
    let content = b"a recording of some bytes";
    free.store(100 + content.len() as u64 - 1, Ordering::Relaxed);
    let error = f.ingest.start(f.new_upload(content)).await.unwrap_err();
    assert!(error.kind() == Kind::Exhausted && error.message().contains("--min-free-bytes"), "{error}");
    assert!(f.store.uploads().await.unwrap().is_empty() && f.files(&["uploads"]).is_empty(), "nothing is left of it");

    free.store(100 + content.len() as u64, Ordering::Relaxed);
    let upload = f.start(content).await;
    assert_eq!(f.write(&upload.id, 0, &content[..9]).await.unwrap(), 9);
    free.store(99, Ordering::Relaxed);
    assert_eq!(f.write(&upload.id, 9, &content[9..]).await.unwrap_err().kind(), Kind::Exhausted);
    assert_eq!(f.ingest.status(&upload.id).await.unwrap().committed, 9, "what was acknowledged stays");
    free.store(u64::MAX, Ordering::Relaxed);
    f.write(&upload.id, 9, &content[9..]).await.unwrap();
    free.store(0, Ordering::Relaxed);
    assert_eq!(f.ingest.finish(&upload.id).await.unwrap_err().kind(), Kind::Exhausted);
    free.store(u64::MAX, Ordering::Relaxed);
    let stored = f.ingest.finish(&upload.id).await.unwrap().episode;
    // What is there already takes no room.
    free.store(0, Ordering::Relaxed);
    assert!(
        matches!(f.ingest.start(f.new_upload(content)).await.unwrap(), Started::Existing(same) if same.id == stored.id)
    );
}

#[tokio::test]
async fn a_recording_that_is_only_looked_at_needs_room_too() {
    let mut f = playing(USABLE).await;
    let free = f.on_a_small_disk();
    free.store(99, Ordering::Relaxed);
    let chunks = stream::iter([Ok(Bytes::from_static(b"recording"))]);
    let error = f.ingest.pass(&f.task.spec, Declared::default(), chunks).await.unwrap_err();
    assert_eq!(error.kind(), Kind::Exhausted, "{error}");
    assert!(f.files(&["tmp"]).is_empty());
}
