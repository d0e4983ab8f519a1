//! Tests of blobs in a folder.

use super::*;

fn names(folder: &Path) -> Vec<PathBuf> {
    fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect()
}

#[test]
fn equal_content_is_one_file() {
    let dir = tempfile::tempdir().unwrap();
    let blobs = Blobs::open(dir.path()).unwrap();
    let id = blobs.put(b"steps").unwrap();
    let by_file = dir.path().join("upload");
    fs::write(&by_file, b"steps").unwrap();
    assert_eq!(blobs.put(b"steps").unwrap(), id);
    assert_eq!(blobs.put_file(&by_file).unwrap(), id);
    assert!(!by_file.exists());
    assert_eq!(blobs.get(&id).unwrap(), b"steps");
    assert_eq!(names(blobs.path(&id).parent().unwrap()), [blobs.path(&id)]);
    assert!(names(&dir.path().join("tmp")).is_empty());
}

#[test]
fn a_damaged_blob_is_an_error() {
    let dir = tempfile::tempdir().unwrap();
    let blobs = Blobs::open(dir.path()).unwrap();
    let id = blobs.put(b"steps").unwrap();
    fs::write(blobs.path(&id), b"stepz").unwrap();
    assert!(blobs.get(&id).unwrap_err().to_string().contains("damaged"));
    // Storing the content again repairs the blob.
    blobs.put(b"steps").unwrap();
    assert_eq!(blobs.get(&id).unwrap(), b"steps");
}

#[test]
fn an_interrupted_write_is_not_a_blob() {
    let dir = tempfile::tempdir().unwrap();
    let blobs = Blobs::open(dir.path()).unwrap();
    fs::write(dir.path().join("tmp/blob-x"), b"half").unwrap();
    assert!(!blobs.contains(&blake3::hash(b"half").into()));
}

#[test]
fn a_failed_move_keeps_the_file() {
    let dir = tempfile::tempdir().unwrap();
    let blobs = Blobs::open(dir.path()).unwrap();
    let id = BlobId::from(blake3::hash(b"steps"));
    // A file stands where the blob's folder should be.
    fs::write(dir.path().join("blobs").join(&id.as_str()[..2]), b"").unwrap();
    let by_file = dir.path().join("upload");
    fs::write(&by_file, b"steps").unwrap();
    assert!(blobs.put_file(&by_file).is_err());
    assert!(blobs.put(b"steps").is_err());
    assert_eq!(fs::read(&by_file).unwrap(), b"steps");
    assert!(names(&dir.path().join("tmp")).is_empty());
}

#[tokio::test]
async fn removing_twice_is_not_an_error() {
    let dir = tempfile::tempdir().unwrap();
    let blobs = Blobs::open(dir.path()).unwrap();
    let id = blobs.put(b"steps").unwrap();
    let removing = blobs.removing().await.unwrap().unwrap();
    assert_eq!(blobs.remove(&id, &removing).unwrap(), Some(5));
    assert_eq!(blobs.remove(&id, &removing).unwrap(), None);
    assert!(!blobs.contains(&id));
}

#[test]
fn the_blobs_of_a_backup_are_not_put_into_a_bucket() {
    let dir = tempfile::tempdir().unwrap();
    let id = Blobs::open(dir.path()).unwrap().put(b"steps").unwrap();
    fs::write(dir.path().join(crate::BACKUP), b"").unwrap();
    let bucket = gleaner_bucket::BucketConfig {
        url: "s3://lab".to_owned(),
        endpoint: Some("http://127.0.0.1:1".to_owned()),
        region: None,
        http: true,
        virtual_host: false,
        timeout_seconds: 1,
    };
    let error = settle(dir.path(), Some((bucket, 0))).unwrap_err();
    assert!(error.message().contains("is a backup") && error.message().contains("restore"), "{error}");
    assert!(!has_bucket(dir.path()) && !dir.path().join("blob-store-owner").exists());
    assert_eq!(Blobs::open(dir.path()).unwrap().get(&id).unwrap(), b"steps");
}
