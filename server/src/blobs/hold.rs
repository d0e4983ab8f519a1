//! Who may rely on a blob's staying, and who may remove one.
//!
//! Three parties, two locks:
//! - *naming*: to look that a blob is there, or put it there, and then commit the row that names it;
//! - *removing*: to look that no row names a blob, and then remove it. Within the server one excludes the other, so that
//!   a blob never goes between the look and the row. Workers put blobs from processes of their own, but only the server
//!   writes rows: at worst it finds that a blob is gone before it names it, and the worker tries again;
//! - *copying*: another process (`backup`, `check`) that reads rows and then the blobs they name. While it does, the
//!   server removes nothing; what is left over the sweep finds later.

use std::{
    fs::{File, OpenOptions, TryLockError},
    path::Path,
};

use tokio::sync::{OwnedRwLockReadGuard, OwnedRwLockWriteGuard};

use super::{Blobs, fault};
use crate::error::Result;

/// Locked by whoever copies, and for a moment by whoever removes.
const FILE: &str = "copying.lock";

/// While it is held, a blob that is there stays.
#[derive(Debug)]
pub(crate) struct Naming {
    _held: OwnedRwLockReadGuard<()>,
}

/// While it is held, no row begins to name a blob. Needed to remove one.
#[derive(Debug)]
pub(crate) struct Removing {
    _held: OwnedRwLockWriteGuard<()>,
    _nobody_copies: File,
}

/// While it is held, a server on this data folder removes no blob.
#[derive(Debug)]
pub(crate) struct Copying {
    _held: Option<File>,
}

impl Blobs {
    /// To be held from before a blob is looked for, or put in its place, until the row that names it is committed.
    pub(crate) async fn naming(&self) -> Naming {
        Naming { _held: std::sync::Arc::clone(&self.naming).read_owned().await }
    }

    /// To be held from before the rows are asked until the blob is removed, and no longer. `None` while somebody copies.
    ///
    /// # Errors
    /// When the lock's file cannot be used.
    pub(crate) async fn removing(&self) -> Result<Option<Removing>> {
        let held = std::sync::Arc::clone(&self.naming).write_owned().await;
        let path = self.folder.join(FILE);
        let file = open(&path).map_err(fault("opening", &path))?;
        match file.try_lock() {
            Ok(()) => Ok(Some(Removing { _held: held, _nobody_copies: file })),
            Err(TryLockError::WouldBlock) => Ok(None),
            Err(TryLockError::Error(error)) => Err(fault("locking", &path)(error)),
        }
    }
}

impl Copying {
    /// Has the server of this data folder keep every blob. On a folder that cannot be written no server runs either.
    ///
    /// # Errors
    /// When the lock's file cannot be locked.
    pub(crate) fn begin(data_dir: &Path) -> Result<Self> {
        let path = data_dir.join(FILE);
        match open(&path) {
            Ok(file) => {
                // Others hold it alone for a moment at most.
                file.lock_shared().map_err(fault("locking", &path))?;
                Ok(Self { _held: Some(file) })
            }
            Err(error) => {
                tracing::debug!(%error, file.path = %path.display(), "nothing is locked");
                Ok(Self { _held: None })
            }
        }
    }
}

fn open(path: &Path) -> std::io::Result<File> {
    OpenOptions::new().create(true).write(true).truncate(false).open(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn nothing_is_removed_between_the_look_and_the_row() {
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

    #[tokio::test]
    async fn nothing_is_removed_while_somebody_copies() {
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
