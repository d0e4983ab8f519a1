//! Damaged copies of blobs that a bucket holds.

use bytes::Bytes;
use gleaner_core::error::Kind;

use super::*;

#[tokio::test]
async fn a_damaged_copy_is_streamed_once_and_then_fetched_again() {
    let Some(store) = test_store() else { return };
    let dir = tempfile::tempdir().unwrap();
    let blobs = blobs_in(&store, &dir, "one", 0);
    let id = blobs.put(b"steps").unwrap();
    fs::write(blobs.path(&id), b"stepz").unwrap();
    let read = async || blobs.stream(&id).await.unwrap().try_collect::<Vec<Bytes>>().await;
    let error = read().await.unwrap_err();
    assert!(error.kind() == Kind::Unavailable && error.message().contains("retry"), "{error}");
    assert!(!blobs.path(&id).exists());
    assert_eq!(read().await.unwrap().concat(), b"steps");
    assert_eq!(fs::read(blobs.path(&id)).unwrap(), b"steps");
    // Without its object no retry would help.
    fs::write(blobs.path(&id), b"stepz").unwrap();
    store.bucket("one").unwrap().remove(&blobs.name(&id)).unwrap();
    let error = read().await.unwrap_err();
    assert!(error.kind() == Kind::Damaged && error.message().contains("--blob-store"), "{error}");
    assert!(blobs.path(&id).exists());
}

#[test]
fn only_a_damaged_copy_whose_object_is_there_is_dropped() {
    let Some(store) = test_store() else { return };
    let dir = tempfile::tempdir().unwrap();
    let (blobs, bucket) = (blobs_in(&store, &dir, "one", 0), store.bucket("one").unwrap());
    let id = blobs.put(b"steps").unwrap();
    assert!(!blobs.drop_damaged_copy(&id).unwrap() && blobs.path(&id).exists(), "it is sound");
    fs::write(blobs.path(&id), b"stepz").unwrap();
    assert!(blobs.drop_damaged_copy(&id).unwrap() && !blobs.path(&id).exists());
    assert_eq!(fs::read(blobs.fetched(&id).unwrap()).unwrap(), b"steps");
    fs::write(blobs.path(&id), b"stepz").unwrap();
    bucket.remove(&remote::name(dir.path(), &blobs.path(&id))).unwrap();
    assert!(!blobs.drop_damaged_copy(&id).unwrap() && blobs.path(&id).exists(), "most of its bytes are nowhere else");
}

#[test]
fn the_blobs_of_a_folder_itself_are_never_dropped() {
    let dir = tempfile::tempdir().unwrap();
    let blobs = Blobs::open(dir.path()).unwrap();
    let id = blobs.put(b"steps").unwrap();
    fs::write(blobs.path(&id), b"stepz").unwrap();
    assert!(!blobs.drop_damaged_copy(&id).unwrap() && blobs.path(&id).exists());
}
