//! Checks that the files a server holds open are still the ones at their paths.
//!
//! A deleted or replaced database stays open as a file without a name: everything written to it is lost with the
//! process. So this check follows each write before it is acknowledged.

use std::{
    io,
    os::unix::fs::MetadataExt as _,
    path::{Path, PathBuf},
    sync::OnceLock,
};

use tokio_util::sync::CancellationToken;

use crate::{LOCK, beside_database, database, stamp};
use gleaner_core::error::{Error, Result};

/// A file, identified by device and inode.
#[derive(Debug)]
struct Held {
    path: PathBuf,
    what: &'static str,
    device: u64,
    inode: u64,
}

/// The files that must stay at their paths while a server runs.
#[derive(Debug)]
pub struct Presence {
    files: Vec<Held>,
    /// The first deleted or replaced file. The error stays even if the file returns: data written meanwhile is
    /// elsewhere.
    loss: OnceLock<String>,
    lost: CancellationToken,
}

impl Presence {
    /// Records the present files of a data folder: the database with its write-ahead log and its index, the stamp and
    /// the lock, as far as they exist.
    ///
    /// # Errors
    /// Internal when a file's metadata cannot be read.
    pub fn note(data_dir: &Path) -> Result<Self> {
        let named = [
            (database(data_dir), "database"),
            (beside_database(data_dir, "-wal"), "write-ahead log of the database"),
            (beside_database(data_dir, "-shm"), "shared index of the database"),
            (stamp::path(data_dir), "stamp of the blobs"),
            (data_dir.join(LOCK), "lock of the data folder"),
        ];
        let mut files = Vec::new();
        for (path, what) in named {
            match std::fs::metadata(&path) {
                Ok(file) => files.push(Held { path, what, device: file.dev(), inode: file.ino() }),
                Err(error) if error.kind() == io::ErrorKind::NotFound => {}
                Err(error) => return Err(Error::internal(format!("looking at {}", path.display()), error)),
            }
        }
        Ok(Self { files, loss: OnceLock::new(), lost: CancellationToken::new() })
    }

    /// Whether every recorded file is still the one that its path names.
    ///
    /// # Errors
    /// Precondition names the file that was deleted or replaced, and what to do.
    pub fn verify(&self) -> Result<()> {
        if self.loss.get().is_none() {
            let Some(loss) = self.files.iter().find_map(Held::loss) else { return Ok(()) };
            self.declare_lost(loss);
        }
        Err(Error::precondition(self.loss.get().cloned().unwrap_or_default()))
    }

    /// Notes a loss that was found elsewhere: from now on [`Presence::verify`] fails with this sentence.
    pub fn declare_lost(&self, loss: String) {
        self.loss.get_or_init(|| loss);
        self.lost.cancel();
    }

    /// A token that is cancelled once a file is found deleted or replaced.
    pub fn lost(&self) -> CancellationToken {
        self.lost.clone()
    }
}

impl Held {
    /// A sentence that names the deleted or replaced file; `None` if every file is in place.
    fn loss(&self) -> Option<String> {
        let change = match std::fs::metadata(&self.path) {
            Ok(found) if (found.dev(), found.ino()) == (self.device, self.inode) => return None,
            Ok(_) => "was replaced",
            Err(error) if matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory) => {
                "was deleted or moved"
            }
            // A disk that fails to respond now may respond later.
            Err(_) => return None,
        };
        Some(format!(
            "the {} {} {change} while the server runs: no change is acknowledged any more. Stop the server, put the file \
             back or restore a backup, and start it again",
            self.what,
            self.path.display()
        ))
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;
    use gleaner_core::error::Kind;

    #[test]
    fn deleted_and_replaced_files_are_detected_permanently() {
        let dir = tempfile::tempdir().unwrap();
        let (place, aside) = (database(dir.path()), dir.path().join("aside"));
        fs::write(&place, b"rows").unwrap();
        let presence = Presence::note(dir.path()).unwrap();
        presence.verify().unwrap();
        assert!(!presence.lost().is_cancelled());
        fs::rename(&place, &aside).unwrap();
        let deleted = presence.verify().unwrap_err();
        assert_eq!(deleted.kind(), Kind::Precondition);
        assert!(deleted.message().contains("gleaner.db was deleted"), "{deleted}");
        assert!(presence.lost().is_cancelled());
        fs::rename(&aside, &place).unwrap();
        assert!(presence.verify().is_err(), "data written meanwhile is elsewhere");
        let again = Presence::note(dir.path()).unwrap();
        fs::write(&aside, b"rows").unwrap();
        fs::rename(&aside, &place).unwrap();
        let replaced = again.verify().unwrap_err();
        assert!(replaced.message().contains("was replaced"), "{replaced}");
    }
}
