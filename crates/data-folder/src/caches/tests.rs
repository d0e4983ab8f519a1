//! Derived files of a few bytes: which are removed, and when.

use std::fs;

use super::*;

struct Folder {
    dir: tempfile::TempDir,
}

impl Folder {
    fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        fs::create_dir(dir.path().join(CACHE)).unwrap();
        Self { dir }
    }

    fn caches(&self, most: Option<u64>) -> Caches {
        Caches::at(self.dir.path()).limited(most)
    }

    /// A file of 10 bytes, made long ago and last used this many seconds later.
    fn file(&self, content: &str, extension: &str, used: u64) -> PathBuf {
        let recording: BlobId = blake3::hash(content.as_bytes()).into();
        let path = self.dir.path().join(CACHE).join(format!("{recording}-0123456789abcdef.{extension}"));
        fs::write(&path, [0; 10]).unwrap();
        let made = SystemTime::UNIX_EPOCH + Duration::from_secs(1000);
        let times = FileTimes::new().set_modified(made).set_accessed(made + Duration::from_secs(used));
        File::options().write(true).open(&path).unwrap().set_times(times).unwrap();
        path
    }
}

fn there<const N: usize>(files: &[PathBuf; N]) -> [bool; N] {
    files.each_ref().map(|path| path.exists())
}

#[test]
fn the_least_recently_used_files_make_room_and_features_before_steps() {
    let folder = Folder::new();
    let all = [("a", "frames", 30), ("b", "frames", 10), ("c", "frames", 20), ("a", FEATURES, 40)];
    let all = all.map(|(content, extension, used)| folder.file(content, extension, used));
    let other = folder.dir.path().join(CACHE).join("notes.txt");
    fs::write(&other, [0; 100]).unwrap();
    let caches = folder.caches(None);
    assert_eq!((caches.fit(u64::MAX).unwrap(), caches.evict(0).unwrap()), (0, 0), "no limit, and enough room");
    assert_eq!((caches.evict(1).unwrap(), there(&all)), (10, [true, true, true, false]));
    assert_eq!((caches.evict(11).unwrap(), there(&all)), (20, [true, false, false, false]));
    assert_eq!((caches.evict(u64::MAX).unwrap(), caches.evict(1).unwrap(), other.exists()), (10, 0, true));
}

#[test]
fn the_limit_holds_before_each_new_file_and_a_large_file_is_kept_alone() {
    let folder = Folder::new();
    let caches = folder.caches(Some(30));
    let old = [10, 20].map(|used| folder.file(&used.to_string(), "frames", used));
    assert_eq!((caches.fit(10).unwrap(), there(&old)), (0, [true, true]));
    let third = folder.file("third", "frames", 30);
    assert_eq!((caches.fit(10).unwrap(), there(&old)), (10, [false, true]));
    assert_eq!((caches.fit(100).unwrap(), there(&old), third.exists()), (20, [false, false], false));
    let many: Vec<PathBuf> =
        (0..REMEMBERED as u64 + 9).map(|used| folder.file(&used.to_string(), "frames", used)).collect();
    folder.caches(Some(10)).fit(0).unwrap();
    assert_eq!(many.iter().position(|path| path.exists()), Some(many.len() - 1), "one listing is not enough");
}

#[test]
fn a_file_used_since_the_listing_stays() {
    let folder = Folder::new();
    let all = [10, 20, 30].map(|used| folder.file(&used.to_string(), "frames", used));
    let caches = folder.caches(Some(30));
    assert_eq!(caches.fit(0).unwrap(), 0);
    note_use(&all[0]);
    assert_eq!((caches.fit(10).unwrap(), there(&all)), (10, [true, false, true]));
    note_use(Path::new("/missing"));
}

#[test]
fn a_file_that_is_kept_for_its_use_counts_against_the_limit() {
    let folder = Folder::new();
    let all = [10, 20, 30, 40].map(|used| folder.file(&used.to_string(), "frames", used));
    let caches = folder.caches(Some(40));
    assert_eq!(caches.fit(0).unwrap(), 0);
    note_use(&all[0]);
    assert_eq!((caches.fit(10).unwrap(), there(&all)), (10, [true, false, true, true]));
    folder.file("first", "frames", 50);
    assert_eq!((caches.fit(10).unwrap(), there(&all)), (10, [true, false, false, true]), "40 bytes are there");
}

#[test]
fn a_missing_folder_has_no_files() {
    let dir = tempfile::tempdir().unwrap();
    assert_eq!(Caches::at(dir.path()).evict(1).unwrap(), 0);
}
