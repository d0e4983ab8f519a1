//! The disk of a folder: its free space, what of it stays free, and the derived files that make room.

#[cfg(any(test, feature = "testing"))]
use std::sync::atomic::{AtomicU64, Ordering};
use std::{
    path::{Path, PathBuf},
    sync::Arc,
};

use rustix::fs::{StatVfs, StatVfsMountFlags, statvfs};

use crate::caches::Caches;
use gleaner_core::error::{Error, Result};

/// The share of the disk for derived files is 1 / this: decoded steps take about as much as their recordings.
const CACHE_SHARE: u64 = 2;

/// The subject of messages about the disk of a data folder.
pub(super) const SERVERS_DISK: &str = "the server's disk (--data-dir)";

/// A folder's disk: the space to keep free, the files that can make room, and how free space is measured.
#[derive(Debug, Clone)]
pub(super) struct Space {
    folder: PathBuf,
    /// The subject of its messages.
    subject: &'static str,
    pub(super) spare: u64,
    pub(super) caches: Arc<Caches>,
    /// The free space in tests, in place of the disk's.
    #[cfg(any(test, feature = "testing"))]
    pub(super) played: Option<Arc<AtomicU64>>,
}

impl Space {
    /// The disk of a folder; none of its space is reserved, and its derived files have no limit.
    pub(super) fn of(folder: &Path, subject: &'static str) -> Self {
        Self {
            folder: folder.to_owned(),
            subject,
            spare: 0,
            caches: Arc::new(Caches::at(folder)),
            #[cfg(any(test, feature = "testing"))]
            played: None,
        }
    }

    /// The same with this many bytes of the disk reserved.
    #[cfg(test)]
    pub(super) fn with_reserve(self, bytes: u64) -> Self {
        Self { spare: bytes, ..self }
    }

    pub(super) fn folder(&self) -> &Path {
        &self.folder
    }

    pub(super) fn limit_caches(&mut self, most_bytes: Option<u64>) -> Result<()> {
        let most = match most_bytes {
            Some(0) => None,
            Some(most) => Some(most),
            None => {
                let disk = disk(&self.folder)?;
                Some(disk.f_blocks.saturating_mul(disk.f_frsize) / CACHE_SHARE)
            }
        };
        self.caches = Arc::new(Caches::at(&self.folder).limited(most));
        Ok(())
    }

    pub(super) fn make_room(&self, bytes: u64) -> Result<()> {
        let missing = self.spare.saturating_add(bytes).saturating_sub(self.free()?);
        if missing > 0 {
            let freed = self.caches.evict(missing)?;
            #[cfg(any(test, feature = "testing"))]
            if let Some(played) = &self.played {
                played.fetch_add(freed, Ordering::Relaxed);
            }
            tracing::debug!(disk.missing = missing, disk.freed = freed, "the disk is short of space");
        }
        self.expect_room(bytes)
    }

    /// As [`Blobs::make_cache_room`].
    pub(super) fn make_cache_room(&self, bytes: u64) -> Result<()> {
        self.caches.fit(bytes)?;
        self.make_room(bytes)
    }

    pub(super) fn expect_room(&self, bytes: u64) -> Result<()> {
        let (free, spare, subject) = (self.free()?, self.spare, self.subject);
        if free.saturating_sub(bytes) >= spare {
            return Ok(());
        }
        let wanted = if bytes > 0 { format!(", and this would take {bytes} of them") } else { String::new() };
        Err(Error::exhausted(format!(
            "{subject} is nearly full: {free} bytes are free{wanted}, and {spare} must stay free (--min-free-bytes). Free \
             some space there, then retry"
        )))
    }

    /// The bytes that may still be written.
    pub(super) fn free(&self) -> Result<u64> {
        #[cfg(any(test, feature = "testing"))]
        if let Some(played) = &self.played {
            return Ok(played.load(Ordering::Relaxed));
        }
        let disk = disk(&self.folder)?;
        if disk.f_flag.contains(StatVfsMountFlags::RDONLY) {
            return Err(Error::exhausted(format!("{} is read-only; remount it for writing, then retry", self.subject)));
        }
        Ok(disk.f_bavail.saturating_mul(disk.f_frsize))
    }
}

pub(super) fn disk(folder: &Path) -> Result<StatVfs> {
    statvfs(folder).map_err(|error| Error::internal("reading the space of the disk", std::io::Error::from(error)))
}
