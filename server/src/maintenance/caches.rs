//! Eviction of derived files: decoded steps of recordings and features of their segments. Both can be rebuilt, and an
//! open file stays readable, so no lock is needed.

use std::{collections::HashSet, io::ErrorKind, path::PathBuf, time::SystemTime};

use crate::{
    data_folder::FEATURES,
    domain::id::BlobId,
    error::{Error, Result},
};

/// Rules of eviction.
pub(super) struct Rules {
    pub(super) folder: PathBuf,
    /// The existing recordings.
    pub(super) named: HashSet<BlobId>,
    /// Files younger than this stay: their recording may not have a row yet.
    pub(super) old: SystemTime,
    /// Features unused since this time are removed.
    pub(super) features_used: SystemTime,
    /// Maximum size in bytes; `None`: no limit.
    pub(super) most_bytes: Option<u64>,
}

struct Cache {
    path: PathBuf,
    recording: BlobId,
    bytes: u64,
    made: SystemTime,
    used: SystemTime,
    features: bool,
}

impl Rules {
    /// Removes the files of deleted recordings and unused features. While the limit is exceeded, it then removes the
    /// least recently used features, and decoded steps last. Returns the number of removed files.
    pub(super) fn sweep(&self) -> Result<u64> {
        let of_no_use = |cache: &Cache| {
            let orphan = cache.made < self.old && !self.named.contains(&cache.recording);
            orphan || cache.features && cache.used < self.features_used
        };
        let (of_no_use, mut kept): (Vec<_>, Vec<_>) = self.list()?.into_iter().partition(of_no_use);
        // Features are useless without their steps, because a score job opens both.
        kept.sort_by_key(|cache| (!cache.features, cache.used));
        let mut left: u64 = kept.iter().map(|cache| cache.bytes).sum();
        let too_many = kept.into_iter().take_while(|cache| {
            let goes = self.most_bytes.is_some_and(|most| left > most);
            left -= if goes { cache.bytes } else { 0 };
            goes
        });
        let mut removed = 0;
        for cache in of_no_use.into_iter().chain(too_many) {
            match std::fs::remove_file(&cache.path) {
                Ok(()) => removed += 1,
                // Removed since the listing.
                Err(error) if error.kind() == ErrorKind::NotFound => {}
                Err(error) => return Err(self.fault(error)),
            }
        }
        Ok(removed)
    }

    /// The derived files; other files are skipped.
    fn list(&self) -> Result<Vec<Cache>> {
        let mut all = Vec::new();
        for entry in std::fs::read_dir(&self.folder).map_err(|error| self.fault(error))? {
            match Cache::read(entry.map_err(|error| self.fault(error))?.path()) {
                Ok(cache) => all.extend(cache),
                // Replaced or removed since the listing.
                Err(error) if error.kind() == ErrorKind::NotFound => {}
                Err(error) => return Err(self.fault(error)),
            }
        }
        Ok(all)
    }

    fn fault(&self, error: std::io::Error) -> Error {
        Error::internal(format!("sweeping {}", self.folder.display()), error)
    }
}

impl Cache {
    /// `None` for a file that is not derived.
    fn read(path: PathBuf) -> std::io::Result<Option<Self>> {
        let recording = path.file_stem().and_then(|name| name.to_str()?.split('-').next()?.to_owned().try_into().ok());
        let Some(recording) = recording else { return Ok(None) };
        let file = std::fs::metadata(&path)?;
        let made = file.modified()?;
        // Some file systems do not record reads; then the oldest are removed first.
        let used = file.accessed().map_or(made, |read| read.max(made));
        let features = path.extension().is_some_and(|extension| extension == FEATURES);
        Ok(Some(Self { path, recording, bytes: file.len(), made, used, features }))
    }
}

#[cfg(test)]
mod tests {
    use std::{
        fs::{self, FileTimes},
        time::Duration,
    };

    use super::*;

    /// A cache of 10 bytes, made long ago and last used this many seconds later.
    fn cache(folder: &std::path::Path, content: &[u8], used: u64) -> (BlobId, PathBuf) {
        file(folder, (content, "frames"), used)
    }

    fn file(folder: &std::path::Path, (content, extension): (&[u8], &str), used: u64) -> (BlobId, PathBuf) {
        let recording: BlobId = blake3::hash(content).into();
        let path = folder.join(format!("{recording}-0123456789abcdef.{extension}"));
        fs::write(&path, [0; 10]).unwrap();
        let made = SystemTime::UNIX_EPOCH + Duration::from_secs(1000);
        let times = FileTimes::new().set_modified(made).set_accessed(made + Duration::from_secs(used));
        fs::File::options().write(true).open(&path).unwrap().set_times(times).unwrap();
        (recording, path)
    }

    #[test]
    fn the_least_recently_used_file_is_removed_first() {
        let dir = tempfile::tempdir().unwrap();
        let all = [(b"a", 30), (b"b", 10), (b"c", 20)].map(|(content, used)| cache(dir.path(), content, used));
        let other = dir.path().join("notes.txt");
        fs::write(&other, [0; 100]).unwrap();
        let rules = |most_bytes| Rules {
            folder: dir.path().to_owned(),
            named: all.iter().map(|(recording, _)| recording.clone()).collect(),
            old: SystemTime::now(),
            features_used: SystemTime::UNIX_EPOCH,
            most_bytes,
        };
        let there = || all.each_ref().map(|(_, path)| path.exists());
        assert_eq!((rules(None).sweep().unwrap(), rules(Some(30)).sweep().unwrap()), (0, 0));
        assert_eq!((rules(Some(29)).sweep().unwrap(), there()), (1, [true, false, true]));
        assert_eq!((rules(Some(10)).sweep().unwrap(), there()), (1, [true, false, false]));
        assert_eq!((rules(Some(0)).sweep().unwrap(), other.exists()), (1, true));
    }

    #[test]
    fn unused_features_are_removed_before_their_steps() {
        let dir = tempfile::tempdir().unwrap();
        let steps = cache(dir.path(), b"a", 0);
        let used = [10, 20].map(|used| file(dir.path(), (if used == 10 { b"a" } else { b"b" }, FEATURES), used));
        let rules = Rules {
            folder: dir.path().to_owned(),
            named: used.iter().map(|(recording, _)| recording.clone()).collect(),
            old: SystemTime::UNIX_EPOCH,
            features_used: SystemTime::UNIX_EPOCH + Duration::from_secs(1020),
            most_bytes: None,
        };
        assert_eq!(rules.sweep().unwrap(), 1);
        assert_eq!((steps.1.exists(), used.each_ref().map(|(_, path)| path.exists())), (true, [false, true]));
        let tight = Rules { most_bytes: Some(10), ..rules };
        assert_eq!((tight.sweep().unwrap(), steps.1.exists(), used[1].1.exists()), (1, true, false));
    }

    #[test]
    fn files_without_a_recording_are_removed_below_the_limit_too() {
        let dir = tempfile::tempdir().unwrap();
        let (kept, gone) = (cache(dir.path(), b"kept", 0), cache(dir.path(), b"gone", 5));
        let rules = Rules {
            folder: dir.path().to_owned(),
            named: HashSet::from([kept.0]),
            old: SystemTime::now(),
            features_used: SystemTime::UNIX_EPOCH,
            most_bytes: Some(10),
        };
        assert_eq!(rules.sweep().unwrap(), 1);
        assert!(kept.1.exists() && !gone.1.exists());
        let young = Rules { old: SystemTime::UNIX_EPOCH, most_bytes: None, ..rules };
        let (_, new) = cache(dir.path(), b"new", 5);
        assert_eq!((young.sweep().unwrap(), new.exists()), (0, true), "its recording may yet be named");
    }
}
