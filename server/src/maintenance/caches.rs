//! The sweep of derived files: those of deleted recordings, and unused features, go whatever the limit on their size.

use std::{collections::HashSet, time::SystemTime};

use crate::{blobs::Blobs, data_folder::caches::Derived, domain::id::BlobId, error::Result};

/// Rules of the sweep.
pub(super) struct Rules {
    pub(super) blobs: Blobs,
    /// The existing recordings.
    pub(super) named: HashSet<BlobId>,
    /// Files younger than this stay: their recording may not have a row yet.
    pub(super) old: SystemTime,
    /// Features unused since this time are removed.
    pub(super) features_used: SystemTime,
}

impl Rules {
    /// Removes the files of deleted recordings and unused features, and returns their number. Then removes others while
    /// the limit on their size is exceeded, which a larger limit before this start may have left.
    pub(super) fn sweep(&self) -> Result<u64> {
        let caches = self.blobs.caches();
        let mut removed = 0;
        caches.visit(|file| {
            removed += u64::from(self.is_of_no_use(&file) && caches.remove(&file)?);
            Ok(())
        })?;
        caches.fit(0)?;
        Ok(removed)
    }

    fn is_of_no_use(&self, file: &Derived) -> bool {
        let orphan = file.made < self.old && !self.named.contains(&file.recording);
        orphan || file.is_features() && file.used < self.features_used
    }
}

#[cfg(test)]
mod tests {
    use std::{
        fs::{self, FileTimes},
        path::PathBuf,
        time::Duration,
    };

    use super::*;
    use crate::data_folder::{CACHE, FEATURES};

    /// A file made long ago and last used this many seconds later.
    fn file(data_dir: &std::path::Path, (content, extension): (&[u8], &str), used: u64) -> (BlobId, PathBuf) {
        let recording: BlobId = blake3::hash(content).into();
        let folder = data_dir.join(CACHE);
        fs::create_dir_all(&folder).unwrap();
        let path = folder.join(format!("{recording}-0123456789abcdef.{extension}"));
        fs::write(&path, [0; 10]).unwrap();
        let made = SystemTime::UNIX_EPOCH + Duration::from_secs(1000);
        let times = FileTimes::new().set_modified(made).set_accessed(made + Duration::from_secs(used));
        fs::File::options().write(true).open(&path).unwrap().set_times(times).unwrap();
        (recording, path)
    }

    fn rules(data_dir: &std::path::Path, named: &[&BlobId], old: SystemTime) -> Rules {
        Rules {
            blobs: Blobs::open(data_dir).unwrap(),
            named: named.iter().copied().cloned().collect(),
            old,
            features_used: SystemTime::UNIX_EPOCH + Duration::from_secs(1020),
        }
    }

    #[test]
    fn unused_features_are_removed_and_their_steps_stay() {
        let dir = tempfile::tempdir().unwrap();
        let (recording, steps) = file(dir.path(), (b"a", "frames"), 0);
        let (other, used) = file(dir.path(), (b"b", FEATURES), 20);
        let (_, unused) = file(dir.path(), (b"a", FEATURES), 10);
        let mut rules = rules(dir.path(), &[&recording, &other], SystemTime::UNIX_EPOCH);
        assert_eq!(rules.sweep().unwrap(), 1);
        assert_eq!((steps.exists(), used.exists(), unused.exists()), (true, true, false));
        rules.blobs = rules.blobs.limiting_caches(Some(10)).unwrap();
        assert_eq!((rules.sweep().unwrap(), steps.exists(), used.exists()), (0, true, false), "a lower limit");
    }

    #[test]
    fn files_without_a_recording_are_removed_once_old_enough() {
        let dir = tempfile::tempdir().unwrap();
        let (named, kept) = file(dir.path(), (b"kept", "frames"), 0);
        let (_, gone) = file(dir.path(), (b"gone", "frames"), 5);
        assert_eq!(rules(dir.path(), &[&named], SystemTime::UNIX_EPOCH).sweep().unwrap(), 0, "it may yet be named");
        assert_eq!(rules(dir.path(), &[&named], SystemTime::now()).sweep().unwrap(), 1);
        assert!(kept.exists() && !gone.exists());
    }
}
