//! The free space of the disk, and the limit below which new data is rejected.
//!
//! Blobs, parts of uploads and recordings lie on the disk of the database. Large writes are rejected while the database
//! still has room, because a full disk would keep it from storing labels or ends of jobs.

use std::path::Path;
#[cfg(any(test, feature = "testing"))]
use std::sync::{Arc, atomic::AtomicU64};

use rustix::fs::{StatVfsMountFlags, statvfs};

use super::Blobs;
use gleaner_core::error::{DISK_FULL, Error, Kind, Result};

/// With less than this free, a writing process will probably find the disk full.
const NOTHING: u64 = 1 << 20;

/// The space to keep free, and how free space is measured.
#[derive(Debug, Clone, Default)]
pub(super) struct Space {
    spare: u64,
    /// The free space in tests, in place of the disk's.
    #[cfg(any(test, feature = "testing"))]
    played: Option<Arc<AtomicU64>>,
}

impl Blobs {
    /// The same blobs with this many bytes of the disk reserved.
    pub fn sparing(mut self, bytes: u64) -> Self {
        self.space.spare = bytes;
        self
    }

    /// The same blobs with simulated free space, for tests.
    #[cfg(any(test, feature = "testing"))]
    pub fn playing(mut self, free: &Arc<AtomicU64>) -> Self {
        self.space.played = Some(Arc::clone(free));
        self
    }

    /// Checks that this many more bytes may be written. The check reserves no space.
    ///
    /// # Errors
    /// Exhausted when too little would stay free, or the disk is read-only.
    pub fn expect_room(&self, bytes: u64) -> Result<()> {
        let free = self.free()?;
        let spare = self.space.spare;
        if free.saturating_sub(bytes) >= spare {
            return Ok(());
        }
        let wanted = if bytes > 0 { format!(", and this would take {bytes} of them") } else { String::new() };
        Err(Error::exhausted(format!(
            "the server's disk is nearly full: {free} bytes are free{wanted}, and {spare} must stay free \
             (--min-free-bytes). Free some space there, then retry"
        )))
    }

    /// Whether no new work may start: too little or hardly any space is free.
    pub fn is_full(&self) -> bool {
        self.expect_room(0).is_err() || self.free().is_ok_and(|free| free < NOTHING)
    }

    /// Maps an error of another process on this disk: without free space, the full disk is its probable cause.
    pub fn blame(&self, fault: Error) -> Error {
        let full = self.free().is_ok_and(|free| free < NOTHING);
        if fault.kind() == Kind::Internal && full {
            return Error::refused_by_disk(DISK_FULL, "another process failed", fault);
        }
        fault
    }

    /// The bytes that may still be written.
    fn free(&self) -> Result<u64> {
        #[cfg(any(test, feature = "testing"))]
        if let Some(played) = &self.space.played {
            return Ok(played.load(std::sync::atomic::Ordering::Relaxed));
        }
        free(&self.folder)
    }
}

fn free(folder: &Path) -> Result<u64> {
    let disk = statvfs(folder)
        .map_err(|error| Error::internal("reading the free space of the disk", std::io::Error::from(error)))?;
    if disk.f_flag.contains(StatVfsMountFlags::RDONLY) {
        return Err(Error::exhausted("the server's disk is read-only; remount it for writing, then retry"));
    }
    Ok(disk.f_bavail.saturating_mul(disk.f_frsize))
}

#[cfg(test)]
mod tests {
    use super::*;

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
        free.store(39, std::sync::atomic::Ordering::Relaxed);
        assert!(blobs.expect_room(0).is_err());
        free.store(u64::MAX, std::sync::atomic::Ordering::Relaxed);
        blobs.expect_room(u64::MAX - 40).unwrap();
    }

    #[test]
    fn a_fault_on_a_full_disk_is_reported_as_a_full_disk() {
        let dir = tempfile::tempdir().unwrap();
        let free = Arc::new(AtomicU64::new(4096));
        let blobs = Blobs::open(dir.path()).unwrap().playing(&free);
        let fault = || Error::internal("inspecting a recording", "exit status: 1");
        assert_eq!(blobs.blame(fault()).kind(), Kind::Exhausted);
        assert_eq!(blobs.blame(Error::invalid("recording", "torn")).kind(), Kind::Invalid);
        free.store(u64::MAX, std::sync::atomic::Ordering::Relaxed);
        assert_eq!(blobs.blame(fault()).kind(), Kind::Internal);
    }

    #[test]
    fn a_full_disk_is_reported_for_any_reserve() {
        let dir = tempfile::tempdir().unwrap();
        let free = Arc::new(AtomicU64::new(4096));
        let blobs = Blobs::open(dir.path()).unwrap().playing(&free);
        blobs.expect_room(0).unwrap();
        assert!(blobs.is_full());
        free.store(2 << 20, std::sync::atomic::Ordering::Relaxed);
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
