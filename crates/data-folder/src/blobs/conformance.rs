//! What both kinds of blobs do alike: the suite runs on a folder and on a bucket, of moto, a double of S3, or of the server
//! that `GLEANER_TEST_S3` names. Where there is neither, the tests of buckets print SKIPPED and pass.

mod damaged;

use std::{
    fs,
    sync::Arc,
    time::{Duration, SystemTime},
};

use futures::TryStreamExt as _;
use gleaner_bucket::testing::TestStore;
use gleaner_core::id::BlobId;
use tempfile::TempDir;

use super::{
    Blobs, Copied,
    remote::{self, Remote},
};

fn test_store() -> Option<TestStore> {
    TestStore::start().unwrap()
}

/// Blobs of a new data folder in a bucket.
fn blobs_in(store: &TestStore, dir: &TempDir, prefix: &str, most_bytes: u64) -> Blobs {
    let plain = Blobs::open(dir.path()).unwrap();
    Blobs { remote: Some(Arc::new(Remote::new(store.bucket(prefix).unwrap(), most_bytes))), ..plain }
}

/// A blob is stored, found, listed, read, streamed, copied, discarded, restored and removed.
async fn conforms(blobs: Blobs) {
    let large: Vec<u8> = (0..=250).cycle().take((70 << 20) + 7).collect();
    let (small, id) = (blobs.put(b"\x89MCAP0\r\nsteps").unwrap(), blobs.put(&large).unwrap());
    let empty = blobs.put(b"").unwrap();
    assert_eq!(blobs.put(&large).unwrap(), id);
    assert_eq!(blobs.size(&id).unwrap(), Some(large.len() as u64));
    assert_eq!((blobs.digest(&id).unwrap(), blobs.size(&empty).unwrap()), (id.clone(), Some(0)));
    let now = SystemTime::now();
    let placed = blobs.placed(&id).unwrap().unwrap();
    assert!(placed < now + Duration::from_secs(60) && placed > now - Duration::from_secs(600));

    let mut listed = blobs.list().unwrap();
    listed.sort_by_key(|found| found.size_bytes);
    let sizes: Vec<_> = listed.iter().map(|found| (found.id.clone().unwrap(), found.size_bytes)).collect();
    assert_eq!(sizes, [(empty.clone(), 0), (small.clone(), 13), (id.clone(), large.len() as u64)]);
    assert!(listed[1].begins_with(b"\x89MCAP0\r\n") && !listed[2].begins_with(b"\x89MCAP0\r\n"));
    assert_eq!(listed[1].digest().unwrap(), small);

    // Without their copies, the bytes come from the bucket.
    for blob in [&id, &small, &empty] {
        if blobs.remote.is_some() {
            fs::remove_file(blobs.path(blob)).unwrap();
        }
    }
    assert!(blobs.get(&id).unwrap() == large && blobs.get(&empty).unwrap().is_empty());
    let pieces: Vec<bytes::Bytes> = blobs.stream(&small).await.unwrap().try_collect().await.unwrap();
    assert_eq!(pieces.concat(), b"\x89MCAP0\r\nsteps");
    assert!(blobs.fetched(&id).unwrap().is_file());

    let (backup, gone) = (tempfile::tempdir().unwrap(), BlobId::from(blake3::hash(b"gone")));
    let copy = Blobs::open(backup.path()).unwrap();
    assert_eq!(copy.copy_from(&blobs, &id, false).unwrap(), Copied::New(large.len() as u64));
    assert_eq!(copy.copy_from(&blobs, &id, true).unwrap(), Copied::There(large.len() as u64));
    assert!(matches!(copy.copy_from(&blobs, &gone, false).unwrap(), Copied::Lacking(_)));
    assert!(copy.get(&id).unwrap() == large);
    let there = [small.clone(), gone.clone()];
    assert_eq!(blobs.count_missing(there.iter()).unwrap(), 1);
    assert!(blobs.size(&gone).unwrap().is_none() && blobs.placed(&gone).unwrap().is_none());
    assert!(blobs.get(&gone).is_err() && blobs.stream(&gone).await.is_err());

    blobs.describe(&small, "ep_a", b"{}").unwrap();
    let removing = blobs.removing().await.unwrap().unwrap();
    assert_eq!(blobs.discard(&small, &removing).unwrap(), Some(13));
    assert_eq!(blobs.discard(&small, &removing).unwrap(), None);
    assert!(!blobs.contains(&small) && blobs.list().unwrap().len() == 2 && blobs.list_trash().unwrap().len() == 1);
    assert!(blobs.take_back(&small).unwrap() && !blobs.take_back(&small).unwrap());
    assert!(blobs.is_described(&small, "ep_a") && blobs.get(&small).unwrap().len() == 13);
    blobs.discard(&small, &removing).unwrap();
    let (before, after) = (now - Duration::from_secs(3600), now + Duration::from_secs(3600));
    assert_eq!(blobs.empty_trash(before, |_, _| false).unwrap(), (0, 0));
    assert_eq!(blobs.empty_trash(after, |_, _| false).unwrap(), (1, 13));
    assert_eq!(blobs.remove(&id, &removing).unwrap(), Some(large.len() as u64));
    assert_eq!(blobs.remove(&id, &removing).unwrap(), None);
    let out = backup.path().join("out");
    blobs.move_out(&empty, &out).unwrap();
    assert!(out.is_file() && blobs.list().unwrap().is_empty() && blobs.list_trash().unwrap().is_empty());
}

#[tokio::test]
async fn a_folder_conforms() {
    let dir = tempfile::tempdir().unwrap();
    conforms(Blobs::open(dir.path()).unwrap()).await;
}

#[tokio::test]
async fn a_bucket_conforms() {
    let Some(store) = test_store() else { return };
    for prefix in ["", "labs/one"] {
        let dir = tempfile::tempdir().unwrap();
        conforms(blobs_in(&store, &dir, prefix, 0)).await;
    }
}

#[test]
fn an_altered_object_is_never_served_and_a_damaged_copy_is_fetched_again() {
    let Some(store) = test_store() else { return };
    let dir = tempfile::tempdir().unwrap();
    let blobs = blobs_in(&store, &dir, "one", 0);
    let id = blobs.put(b"steps").unwrap();
    fs::write(blobs.path(&id), b"stepz").unwrap();
    assert_eq!(blobs.get(&id).unwrap(), b"steps");
    let altered = dir.path().join("altered");
    fs::write(&altered, b"stepz").unwrap();
    store.bucket("one").unwrap().put(&remote::name(dir.path(), &blobs.path(&id)), &altered).unwrap();
    fs::remove_file(blobs.path(&id)).unwrap();
    assert!(blobs.fetched(&id).unwrap_err().to_string().contains("damaged"));
    assert!(!blobs.path(&id).exists() && blobs.digest(&id).unwrap() != id);
    // Storing the content again repairs the object.
    blobs.put(b"steps").unwrap();
    assert_eq!(blobs.digest(&id).unwrap(), id);
}

#[test]
fn copies_stay_below_their_limit_and_the_least_recently_used_go_first() {
    let Some(store) = test_store() else { return };
    let dir = tempfile::tempdir().unwrap();
    let blobs = blobs_in(&store, &dir, "one", 1000);
    let ids: Vec<BlobId> = (0..3).map(|n| blobs.put(&[n; 400]).unwrap()).collect();
    assert!(!blobs.path(&ids[0]).exists() && blobs.path(&ids[1]).exists() && blobs.path(&ids[2]).exists());
    assert_eq!(blobs.get(&ids[0]).unwrap(), [0; 400]);
    assert!(!blobs.path(&ids[1]).exists());
}

#[test]
fn a_copy_is_kept_and_sent_again_where_the_store_has_lost_its_object_or_a_part_of_it() {
    let Some(store) = test_store() else { return };
    let dir = tempfile::tempdir().unwrap();
    let blobs = blobs_in(&store, &dir, "one", 1000);
    let bucket = store.bucket("one").unwrap();
    let [lost, cut] = [1, 2].map(|n| blobs.put(&[n; 400]).unwrap());
    let name = |id: &BlobId| remote::name(dir.path(), &blobs.path(id));
    bucket.remove(&name(&lost)).unwrap();
    let part = dir.path().join("part");
    fs::write(&part, [2; 100]).unwrap();
    bucket.put(&name(&cut), &part).unwrap();

    blobs.put(&[3; 400]).unwrap();
    assert!(blobs.path(&lost).exists() && blobs.path(&cut).exists());
    for id in [&lost, &cut] {
        assert_eq!(&blobs.digest(id).unwrap(), id, "the object is whole again");
    }
    // A damaged copy is not sent in the place of an object.
    fs::write(blobs.path(&cut), [9; 300]).unwrap();
    blobs.put(&[4; 400]).unwrap();
    blobs.put(&[5; 400]).unwrap();
    assert!(!blobs.path(&cut).exists());
    assert_eq!(blobs.digest(&cut).unwrap(), cut);
}

#[test]
fn a_fetched_file_outlives_the_copy_that_makes_room_for_others() {
    let Some(store) = test_store() else { return };
    let dir = tempfile::tempdir().unwrap();
    let blobs = blobs_in(&store, &dir, "one", 1000);
    let before = std::time::SystemTime::now();
    let id = blobs.put(&[0; 400]).unwrap();
    // Not by the clock of the file system, which is behind by some milliseconds.
    assert!(fs::metadata(blobs.path(&id)).unwrap().accessed().unwrap() >= before);
    let fetched = blobs.fetched(&id).unwrap();
    for n in 1..3 {
        blobs.put(&[n; 400]).unwrap();
    }
    assert!(!blobs.path(&id).exists());
    assert_eq!(fs::read(&fetched).unwrap(), [0; 400]);
    assert_eq!(blobs.list().unwrap().len(), 3, "a second name is no blob");
    let name = fetched.to_path_buf();
    drop(fetched);
    assert!(!name.exists());
}

#[test]
fn a_sent_file_is_sent_again_only_if_its_object_is_gone() {
    let Some(store) = test_store() else { return };
    let dir = tempfile::tempdir().unwrap();
    let blobs = blobs_in(&store, &dir, "one", 0);
    let (bucket, part, other) = (store.bucket("one").unwrap(), dir.path().join("part"), dir.path().join("other"));
    let id = BlobId::from(blake3::hash(b"steps"));
    let name = remote::name(dir.path(), &blobs.path(&id));
    let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
    let naming = runtime.block_on(blobs.naming());
    let place = || {
        fs::write(&part, b"steps").unwrap();
        blobs.place_sent(&id, &part, &naming).unwrap();
    };
    fs::write(&part, b"steps").unwrap();
    blobs.send(&id, &part).unwrap();
    assert!(!blobs.path(&id).exists() && blobs.contains(&id));
    fs::write(&other, b"other").unwrap();
    bucket.put(&name, &other).unwrap();
    place();
    assert_eq!(blobs.digest(&id).unwrap(), BlobId::from(blake3::hash(b"other")), "the object was not sent again");
    bucket.remove(&name).unwrap();
    place();
    assert_eq!(blobs.digest(&id).unwrap(), id);
}

#[test]
fn a_lost_object_is_sent_again_from_a_sound_copy() {
    let Some(store) = test_store() else { return };
    let dir = tempfile::tempdir().unwrap();
    let (blobs, bucket) = (blobs_in(&store, &dir, "one", 0), store.bucket("one").unwrap());
    let id = blobs.put(b"steps").unwrap();
    let (name, other) = (remote::name(dir.path(), &blobs.path(&id)), dir.path().join("other"));
    bucket.remove(&name).unwrap();
    assert!(blobs.size(&id).unwrap().is_none() && blobs.resend(&id).unwrap());
    fs::write(&other, b"other").unwrap();
    bucket.put(&name, &other).unwrap();
    assert!(blobs.resend(&id).unwrap());
    assert_eq!(blobs.digest(&id).unwrap(), id);
    bucket.remove(&name).unwrap();
    fs::write(blobs.path(&id), b"st").unwrap();
    assert!(!blobs.resend(&id).unwrap() && blobs.size(&id).unwrap().is_none(), "a damaged copy is not sent");
}

/// The folder has lost the name of its bucket, so its files look like the blobs themselves.
#[test]
fn a_move_replaces_no_object_by_a_damaged_file() {
    let Some(store) = test_store() else { return };
    let dir = tempfile::tempdir().unwrap();
    let (blobs, bucket) = (blobs_in(&store, &dir, "one", 0), store.bucket("one").unwrap());
    let [altered, cut, whole, new] = [1, 2, 3, 4].map(|n| blobs.put(&[n; 400]).unwrap());
    fs::write(blobs.path(&altered), [9; 400]).unwrap();
    fs::write(blobs.path(&cut), [2; 100]).unwrap();
    let part = dir.path().join("part");
    fs::write(&part, [3; 100]).unwrap();
    bucket.put(&remote::name(dir.path(), &blobs.path(&whole)), &part).unwrap();
    bucket.remove(&remote::name(dir.path(), &blobs.path(&new))).unwrap();
    remote::fill(&bucket, &Blobs::open(dir.path()).unwrap()).unwrap();
    for id in [altered, cut, whole, new] {
        assert_eq!(blobs.digest(&id).unwrap(), id, "the object is whole");
    }
}

#[test]
fn a_bucket_has_one_data_folder() {
    let Some(store) = test_store() else { return };
    let bucket = store.bucket("one").unwrap();
    bucket.claim("this").unwrap();
    bucket.claim("this").unwrap();
    assert!(bucket.claim("other").unwrap_err().message().contains("another data folder"));
    store.bucket("two").unwrap().claim("other").unwrap();
    let emptied = store.bucket("three").unwrap().expect_owner("this").unwrap_err();
    assert!(emptied.message().contains("another store than before"), "{emptied}");
}

#[test]
fn a_blob_that_leaves_a_bucket_has_the_content_of_its_object() {
    let Some(store) = test_store() else { return };
    let (dir, out) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let blobs = blobs_in(&store, &dir, "one", 0);
    let id = blobs.put(b"steps").unwrap();
    fs::write(blobs.path(&id), b"st").unwrap();
    let to = out.path().join("steps");
    blobs.move_out(&id, &to).unwrap();
    assert_eq!(fs::read(&to).unwrap(), b"steps");
    assert!(blobs.size(&id).unwrap().is_none());
}

#[test]
fn an_owner_is_kept_from_an_interrupted_move() {
    let dir = tempfile::tempdir().unwrap();
    let first = remote::kept_owner(dir.path()).unwrap();
    assert_eq!(remote::kept_owner(dir.path()).unwrap(), first);
    let other = tempfile::tempdir().unwrap();
    assert_ne!(remote::kept_owner(other.path()).unwrap(), first);
}
