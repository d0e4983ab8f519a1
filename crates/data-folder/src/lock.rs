//! The lock on a data folder: one leader for each, because two would both own its database, uploads and jobs. A standby
//! takes it when the leader is gone.
//!
//! It is the system's lock on an open file, which is released however a server ends. A file system that several machines
//! share must keep such locks for all of them, as NFSv4 does unless it is mounted with `nolock` or `local_lock`.

use std::{
    fs::{File, OpenOptions, TryLockError},
    path::Path,
};

use crate::{LOCK, STANDBYS, access::make_private_folder};
use gleaner_core::error::{Error, Result};

/// A locked data folder, released on drop.
#[derive(Debug)]
pub struct DataLock {
    _held: LockedFile,
}

/// A file with the system's lock, which is released on drop.
///
/// Closing the file alone may release the lock too late: a child process that was just forked holds a copy of the open
/// file until it executes its program.
#[derive(Debug)]
pub(crate) struct LockedFile(File);

impl LockedFile {
    /// Locks the file for this holder only. `None` while another one holds it.
    ///
    /// # Errors
    /// When the system cannot lock it.
    pub(crate) fn exclusive(file: File) -> std::io::Result<Option<Self>> {
        match file.try_lock() {
            Ok(()) => Ok(Some(Self(file))),
            Err(TryLockError::WouldBlock) => Ok(None),
            Err(TryLockError::Error(error)) => Err(error),
        }
    }

    /// Locks the file together with other shared holders, after waiting for an exclusive one.
    ///
    /// # Errors
    /// When the system cannot lock it.
    pub(crate) fn shared(file: File) -> std::io::Result<Self> {
        file.lock_shared()?;
        Ok(Self(file))
    }
}

impl Drop for LockedFile {
    fn drop(&mut self) {
        if let Err(error) = self.0.unlock() {
            tracing::warn!(%error, "a lock was not released; it ends with this process");
        }
    }
}

impl DataLock {
    /// Locks a data folder, which is created if missing.
    ///
    /// # Errors
    /// Precondition when another server holds it, or it cannot be used.
    pub fn take(data_dir: &Path) -> Result<Self> {
        let shown = data_dir.display();
        if !data_dir.is_dir() {
            make(data_dir).map_err(|error| unusable(data_dir, error))?;
        }
        Self::take_if_free(data_dir)?.ok_or_else(|| {
            Error::precondition(format!(
                "another gleaner-server uses the data folder {shown}; stop that one, give this one another --data-dir, or, \
                 with --database, start it as a standby of the other with --standby"
            ))
        })
    }

    /// Locks an existing data folder; `None` while another server holds it.
    ///
    /// # Errors
    /// Precondition when it cannot be used.
    pub fn take_if_free(data_dir: &Path) -> Result<Option<Self>> {
        let path = data_dir.join(LOCK);
        let file = OpenOptions::new().create(true).write(true).truncate(false).open(&path);
        let held = file.and_then(LockedFile::exclusive).map_err(|error| unusable(data_dir, error))?;
        Ok(held.map(|held| Self { _held: held }))
    }
}

/// The presence of a standby, whose temporary files are in the data folder too: until it is dropped, no other server
/// removes them.
#[derive(Debug)]
pub struct StandbyLock {
    _held: LockedFile,
}

impl StandbyLock {
    /// Joins the standbys of a data folder, after waiting for a start that removes temporary files.
    ///
    /// # Errors
    /// Precondition when the folder cannot be used.
    pub fn join(data_dir: &Path) -> Result<Self> {
        let held = standbys(data_dir).and_then(LockedFile::shared).map_err(|error| unusable(data_dir, error))?;
        Ok(Self { _held: held })
    }

    /// Keeps standbys from joining until the lock is dropped; `None` while there is one.
    ///
    /// # Errors
    /// When the system cannot lock the file.
    pub fn keep_out(data_dir: &Path) -> std::io::Result<Option<Self>> {
        let held = standbys(data_dir).and_then(LockedFile::exclusive)?;
        Ok(held.map(|held| Self { _held: held }))
    }
}

fn standbys(data_dir: &Path) -> std::io::Result<File> {
    OpenOptions::new().create(true).read(true).write(true).truncate(false).open(data_dir.join(STANDBYS))
}

fn unusable(data_dir: &Path, error: std::io::Error) -> Error {
    Error::precondition(format!("cannot use the data folder {} (--data-dir): {error}", data_dir.display()))
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
        assert!(DataLock::take_if_free(&folder).unwrap().is_none());
        DataLock::take(&dir.path().join("other")).unwrap();
        assert!(DataLock::take_if_free(&dir.path().join("absent")).is_err(), "it makes no folder");
        drop(first);
        DataLock::take(&folder).unwrap();
    }

    #[test]
    fn standbys_share_a_folder_that_a_start_has_alone() {
        let dir = tempfile::tempdir().unwrap();
        let standbys = [(); 2].map(|()| StandbyLock::join(dir.path()).unwrap());
        assert!(StandbyLock::keep_out(dir.path()).unwrap().is_none());
        drop(standbys);
        assert!(StandbyLock::keep_out(dir.path()).unwrap().is_some());
        assert!(StandbyLock::join(&dir.path().join("absent")).unwrap_err().message().contains("--data-dir"));
    }

    /// A child process that was just forked holds copies of all open files until it executes its program.
    #[test]
    fn a_copy_of_the_open_file_keeps_no_lock() {
        let file = tempfile::tempfile().unwrap();
        let path = format!("/proc/self/fd/{}", std::os::fd::AsRawFd::as_raw_fd(&file));
        let other = || File::open(&path).unwrap();
        let _copy = file.try_clone().unwrap();
        let locked = LockedFile::exclusive(file.try_clone().unwrap()).unwrap().unwrap();
        assert!(LockedFile::exclusive(other()).unwrap().is_none());
        drop(locked);
        let shared = LockedFile::shared(file.try_clone().unwrap()).unwrap();
        assert!(LockedFile::exclusive(other()).unwrap().is_none());
        drop(shared);
        assert!(LockedFile::exclusive(other()).unwrap().is_some());
    }

    #[test]
    fn a_folder_that_cannot_be_created_is_named() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let message = DataLock::take(&file.path().join("lab")).unwrap_err().message().to_owned();
        assert!(message.contains("lab (--data-dir)"), "{message}");
    }
}
