//! The lock on a data folder: one server for each, because two would both own its database, uploads and jobs.
//!
//! It is the system's lock on an open file, which is released however a server ends.

use std::{
    fs::{File, OpenOptions, TryLockError},
    path::Path,
};

use crate::{LOCK, access::make_private_folder};
use gleaner_core::error::{Error, Result};

/// A locked data folder, released on drop.
#[derive(Debug)]
pub struct DataLock {
    _held: File,
}

impl DataLock {
    /// Locks a data folder, which is created if missing.
    ///
    /// # Errors
    /// Precondition when another server holds it, or it cannot be used.
    pub fn take(data_dir: &Path) -> Result<Self> {
        let shown = data_dir.display();
        let unusable =
            |error: std::io::Error| Error::precondition(format!("cannot use the data folder {shown}: {error}"));
        if !data_dir.is_dir() {
            make(data_dir).map_err(unusable)?;
        }
        let path = data_dir.join(LOCK);
        let file = OpenOptions::new().create(true).write(true).truncate(false).open(&path).map_err(unusable)?;
        match file.try_lock() {
            Ok(()) => Ok(Self { _held: file }),
            Err(TryLockError::WouldBlock) => Err(Error::precondition(format!(
                "another gleaner-server uses the data folder {shown}; stop that one, or give this one another --data-dir"
            ))),
            Err(TryLockError::Error(error)) => Err(unusable(error)),
        }
    }
}

/// Creates a folder and its missing parents, and syncs their names.
fn make(folder: &Path) -> std::io::Result<()> {
    let parent = folder.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    if !parent.is_dir() {
        make(parent)?;
    }
    match make_private_folder(folder) {
        Err(error) if error.kind() != std::io::ErrorKind::AlreadyExists => return Err(error),
        Ok(()) | Err(_) => {}
    }
    File::open(parent)?.sync_all()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_has_one_server_at_a_time() {
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("here/lab");
        let first = DataLock::take(&folder).unwrap();
        let message = DataLock::take(&folder).unwrap_err().message().to_owned();
        assert!(message.contains(&folder.display().to_string()) && message.contains("--data-dir"), "{message}");
        DataLock::take(&dir.path().join("other")).unwrap();
        drop(first);
        // A child that another test has just forked also holds the lock until it executes its program.
        let begun = std::time::Instant::now();
        while let Err(error) = DataLock::take(&folder) {
            assert!(begun.elapsed() < std::time::Duration::from_secs(10), "{error}");
            std::thread::yield_now();
        }
    }

    #[test]
    fn a_folder_that_cannot_be_created_is_named() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let message = DataLock::take(&file.path().join("lab")).unwrap_err().message().to_owned();
        assert!(message.contains("lab"), "{message}");
    }
}
