//! Locks that keep a blob in place or permit its removal.
//!
//! Three parties, two locks:
//!
//! - *naming*: finding or storing a blob, then committing the row that names it;
//! - *removing*: checking that no row names a blob, then removing it. Within the server the two exclude each other, so
//!   that a blob is never removed between the check and the row. Workers store blobs from their own processes, but only
//!   the server writes rows: at worst a blob is removed before it is named, and the worker retries;
//! - *copying*: another process (`backup`, `check`) that reads rows and then the blobs they name. Meanwhile the server
//!   removes no blob; a later sweep removes the blobs that were kept.

use std::{
    fs::{File, OpenOptions},
    path::Path,
};

use tokio::sync::{OwnedRwLockReadGuard, OwnedRwLockWriteGuard};

use super::{Blobs, fault};
use crate::lock::LockedFile;
use gleaner_core::error::Result;

/// Locked during a copy, and briefly during a removal.
const FILE: &str = "copying.lock";

/// Existing blobs stay while this is held.
#[derive(Debug)]
pub struct Naming {
    _held: OwnedRwLockReadGuard<()>,
}

/// No row begins to name a blob while this is held. Required to remove a blob.
#[derive(Debug)]
pub struct Removing {
    _held: OwnedRwLockWriteGuard<()>,
    _no_copy: LockedFile,
}

/// A server on this data folder removes no blob while this is held.
#[derive(Debug)]
pub struct Copying {
    _held: Option<LockedFile>,
}

impl Blobs {
    /// The lock to hold from before a blob is looked up or stored until the row that names it is committed.
    pub async fn naming(&self) -> Naming {
        Naming { _held: std::sync::Arc::clone(&self.naming).read_owned().await }
    }

    /// The lock to hold from before the rows are read until the blob is removed, and no longer. `None` during a copy.
    ///
    /// # Errors
    /// When the lock's file cannot be used.
    pub async fn removing(&self) -> Result<Option<Removing>> {
        let held = std::sync::Arc::clone(&self.naming).write_owned().await;
        let path = self.folder.join(FILE);
        let file = open(&path).map_err(fault("opening", &path))?;
        let no_copy = LockedFile::exclusive(file).map_err(fault("locking", &path))?;
        Ok(no_copy.map(|no_copy| Removing { _held: held, _no_copy: no_copy }))
    }
}

impl Copying {
    /// Makes the server of this data folder keep every blob. No server runs on a read-only folder.
    ///
    /// # Errors
    /// When the lock's file cannot be locked.
    pub fn begin(data_dir: &Path) -> Result<Self> {
        let path = data_dir.join(FILE);
        match open(&path) {
            Ok(file) => {
                // The server holds it exclusively for a moment at most.
                let held = LockedFile::shared(file).map_err(fault("locking", &path))?;
                Ok(Self { _held: Some(held) })
            }
            Err(error) => {
                tracing::debug!(%error, file.path = %path.display(), "the data folder is read-only and not locked");
                Ok(Self { _held: None })
            }
        }
    }
}

/// For both kinds of lock: NFS keeps them as locks on ranges, and rejects a shared one on a file that is not open to read.
fn open(path: &Path) -> std::io::Result<File> {
    OpenOptions::new().create(true).read(true).write(true).truncate(false).open(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn no_blob_is_removed_between_the_check_and_the_row() {
        let dir = tempfile::tempdir().unwrap();
        let blobs = Blobs::open(dir.path()).unwrap();
        let (one, two) = (blobs.naming().await, blobs.clone().naming().await);
        let removing = blobs.removing();
        tokio::pin!(removing);
        assert!(futures::poll!(&mut removing).is_pending(), "two are naming");
        drop((one, two));
        let removing = removing.await.unwrap().unwrap();
        let naming = blobs.naming();
        tokio::pin!(naming);
        assert!(futures::poll!(&mut naming).is_pending(), "one is removing");
        drop(removing);
        naming.await;
    }

    #[test]
    fn the_file_of_the_lock_is_open_to_read_and_to_write() {
        let dir = tempfile::tempdir().unwrap();
        let mut file = open(&dir.path().join(FILE)).unwrap();
        assert_eq!(std::io::Read::read(&mut file, &mut [0]).unwrap(), 0);
        assert_eq!(std::io::Write::write(&mut file, &[0]).unwrap(), 1);
    }

    #[tokio::test]
    async fn no_blob_is_removed_during_a_copy() {
        let dir = tempfile::tempdir().unwrap();
        let blobs = Blobs::open(dir.path()).unwrap();
        let (one, two) = (Copying::begin(dir.path()).unwrap(), Copying::begin(dir.path()).unwrap());
        assert!(blobs.removing().await.unwrap().is_none());
        drop(one);
        assert!(blobs.removing().await.unwrap().is_none());
        drop(two);
        assert!(blobs.removing().await.unwrap().is_some());
    }
}
