//! The free space of the disk, and the limit below which new data is rejected.
//!
//! Blobs, parts of uploads and recordings lie on the disk of the database. Large writes are rejected while the database
//! still has room, because a full disk would keep it from storing labels or ends of jobs.

#[cfg(any(test, feature = "testing"))]
use std::sync::{Arc, atomic::AtomicU64};

use std::path::Path;

use super::Blobs;
use crate::caches::Caches;
use gleaner_core::error::{DISK_FULL, Error, Kind, Result};

/// With less than this free, a writing process will probably find the disk full.
const NOTHING: u64 = 1 << 20;

impl Blobs {
    /// The same blobs with this many bytes of the disk reserved.
    pub fn sparing(mut self, bytes: u64) -> Self {
        self.space.spare = bytes;
        if let Some(node) = &mut self.node {
            node.spare = bytes;
        }
        self
    }

    /// The same blobs with a limit on the size of derived files. `None`: half of the disk; 0: no limit.
    ///
    /// # Errors
    /// Internal when the size of the disk cannot be read.
    pub fn limiting_caches(mut self, most_bytes: Option<u64>) -> Result<Self> {
        self.space.limit_caches(most_bytes)?;
        if let Some(node) = &mut self.node {
            node.limit_caches(most_bytes)?;
        }
        Ok(self)
    }

    /// The derived files of the data folder, which make room for other data.
    pub fn caches(&self) -> &Caches {
        &self.space.caches
    }

    /// The same blobs with simulated free space, for tests.
    #[cfg(any(test, feature = "testing"))]
    pub fn playing(mut self, free: &Arc<AtomicU64>) -> Self {
        self.space.played = Some(Arc::clone(free));
        self
    }

    /// Makes room for this many more bytes: while too little would stay free, the least recently used derived files are
    /// removed. The call reserves no space, and may list a folder of many files.
    ///
    /// # Errors
    /// Exhausted when too little would stay free without derived files too, or the disk is read-only.
    pub fn make_room(&self, bytes: u64) -> Result<()> {
        self.space.make_room(bytes)
    }

    /// As [`Blobs::make_room`], off the runtime when files have to be removed.
    ///
    /// # Errors
    /// As for [`Blobs::make_room`].
    pub async fn room_for(&self, bytes: u64) -> Result<()> {
        if self.expect_room(bytes).is_ok() {
            return Ok(());
        }
        let blobs = self.clone();
        let making = tokio::task::spawn_blocking(move || blobs.make_room(bytes));
        making.await.map_err(|error| Error::internal("making room on the disk", error))?
    }

    /// Makes room for a new file of decoded steps: below the limit of derived files, and on the disk.
    ///
    /// # Errors
    /// As for [`Blobs::make_room`].
    pub fn make_cache_room(&self, bytes: u64) -> Result<()> {
        self.node.as_ref().unwrap_or(&self.space).make_cache_room(bytes)
    }

    /// Removes derived files beside decoded steps that found the disk full, at least `bytes` of them if there are as many;
    /// returns whether there were any.
    ///
    /// # Errors
    /// Internal when the disk fails.
    pub fn evict_steps(&self, bytes: u64) -> Result<bool> {
        Ok(self.node.as_ref().unwrap_or(&self.space).caches.evict(bytes)? > 0)
    }

    /// Counts a new file of decoded steps by its own size, where room was made for `expected` bytes: other files go if they
    /// exceed their limit with it.
    ///
    /// # Errors
    /// Internal when the disk fails.
    pub fn count_cache(&self, path: &Path, expected: u64) -> Result<()> {
        self.node.as_ref().unwrap_or(&self.space).caches.count(path, expected)
    }

    /// Checks that this many more bytes may be written. The check reserves no space.
    ///
    /// # Errors
    /// Exhausted when too little would stay free, or the disk is read-only.
    pub fn expect_room(&self, bytes: u64) -> Result<()> {
        self.space.expect_room(bytes)
    }

    /// Whether no new work may start: too little or hardly any space is free.
    pub fn is_full(&self) -> bool {
        self.expect_room(0).is_err() || self.space.free().is_ok_and(|free| free < NOTHING)
    }

    /// Maps an error of another process on this disk: without free space, the full disk is its probable cause.
    pub fn blame(&self, fault: Error) -> Error {
        let full = self.space.free().is_ok_and(|free| free < NOTHING);
        if fault.kind() == Kind::Internal && full {
            return Error::refused_by_disk(DISK_FULL, "another process failed", fault);
        }
        fault
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::Ordering;

    use super::*;
    use crate::blobs::space::disk;

    #[test]
    fn data_that_would_leave_too_little_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let free = Arc::new(AtomicU64::new(100));
        let blobs = Blobs::open(dir.path()).unwrap().sparing(40).playing(&free);
        blobs.expect_room(0).unwrap();
        blobs.expect_room(60).unwrap();
        let error = blobs.expect_room(61).unwrap_err();
        assert_eq!(error.kind(), Kind::Exhausted);
        for part in ["100 bytes", "61", "40 must stay", "--min-free-bytes"] {
            assert!(error.message().contains(part), "{error}");
        }
        free.store(39, Ordering::Relaxed);
        assert!(blobs.expect_room(0).is_err());
        free.store(u64::MAX, Ordering::Relaxed);
        blobs.expect_room(u64::MAX - 40).unwrap();
    }

    #[tokio::test]
    async fn derived_files_make_room_for_other_data() {
        let dir = tempfile::tempdir().unwrap();
        let caches = dir.path().join(crate::CACHE);
        std::fs::create_dir(&caches).unwrap();
        let cached =
            ["one", "two"].map(|content| caches.join(format!("{}-00.frames", blake3::hash(content.as_bytes()))));
        cached.iter().for_each(|path| std::fs::write(path, [0; 10]).unwrap());
        let free = Arc::new(AtomicU64::new(100));
        let blobs = Blobs::open(dir.path()).unwrap().sparing(40).playing(&free);
        let left = || cached.iter().filter(|path| path.exists()).count();
        blobs.room_for(60).await.unwrap();
        assert_eq!(left(), 2, "there was room");
        blobs.room_for(61).await.unwrap();
        assert_eq!((left(), free.load(Ordering::Relaxed)), (1, 110));
        let error = blobs.make_room(81).unwrap_err();
        assert!(error.message().contains("120 bytes are free"), "{error}");
        assert_eq!(left(), 0);
    }

    #[test]
    fn a_file_counts_by_its_size_when_it_is_written_and_stays() {
        let dir = tempfile::tempdir().unwrap();
        let caches = dir.path().join(crate::CACHE);
        std::fs::create_dir(&caches).unwrap();
        let path = |content: &[u8]| caches.join(format!("{}-00.frames", blake3::hash(content)));
        let (before, new) = (path(b"one"), path(b"two"));
        for (bytes, stays) in [(10, true), (11, false), (30, false)] {
            std::fs::write(&before, [0; 10]).unwrap();
            let blobs = Blobs::open(dir.path()).unwrap().limiting_caches(Some(20)).unwrap();
            blobs.make_cache_room(8).unwrap();
            std::fs::write(&new, vec![0; bytes]).unwrap();
            blobs.count_cache(&new, 8).unwrap();
            assert_eq!((before.exists(), new.exists()), (stays, true), "{bytes}");
            std::fs::remove_file(&new).unwrap();
        }
    }

    #[test]
    fn the_limit_of_derived_files_is_half_of_the_disk_by_default() {
        let dir = tempfile::tempdir().unwrap();
        let caches = dir.path().join(crate::CACHE);
        std::fs::create_dir(&caches).unwrap();
        let blobs = |most| Blobs::open(dir.path()).unwrap().limiting_caches(most).unwrap();
        let cached = caches.join(format!("{}-00.frames", blake3::hash(b"one")));
        let disk = disk(dir.path()).unwrap();
        let half = disk.f_blocks * disk.f_frsize / 2;
        std::fs::write(&cached, [0; 10]).unwrap();
        for (most, bytes, stays) in [
            (Some(0), u64::MAX, true),
            (None, half - 10, true),
            (Some(20), 10, true),
            (Some(20), 11, false),
            (None, half, false),
        ] {
            std::fs::write(&cached, [0; 10]).unwrap();
            blobs(most).caches().fit(bytes).unwrap();
            assert_eq!(cached.exists(), stays, "{most:?} {bytes}");
        }
    }

    #[test]
    fn a_fault_on_a_full_disk_is_reported_as_a_full_disk() {
        let dir = tempfile::tempdir().unwrap();
        let free = Arc::new(AtomicU64::new(4096));
        let blobs = Blobs::open(dir.path()).unwrap().playing(&free);
        let fault = || Error::internal("inspecting a recording", "exit status: 1");
        assert_eq!(blobs.blame(fault()).kind(), Kind::Exhausted);
        assert_eq!(blobs.blame(Error::invalid("recording", "torn")).kind(), Kind::Invalid);
        free.store(u64::MAX, Ordering::Relaxed);
        assert_eq!(blobs.blame(fault()).kind(), Kind::Internal);
    }

    #[test]
    fn a_full_disk_is_reported_for_any_reserve() {
        let dir = tempfile::tempdir().unwrap();
        let free = Arc::new(AtomicU64::new(4096));
        let blobs = Blobs::open(dir.path()).unwrap().playing(&free);
        blobs.expect_room(0).unwrap();
        assert!(blobs.is_full());
        free.store(2 << 20, Ordering::Relaxed);
        assert!(!blobs.is_full() && blobs.sparing(3 << 20).is_full());
    }

    #[test]
    fn the_free_space_of_a_real_disk_is_read() {
        let dir = tempfile::tempdir().unwrap();
        let blobs = Blobs::open(dir.path()).unwrap();
        blobs.expect_room(1).unwrap();
        assert!(blobs.expect_room(u64::MAX).is_ok(), "no space is kept free");
        assert!(blobs.clone().sparing(u64::MAX).expect_room(0).is_err());
    }
}
