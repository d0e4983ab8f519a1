//! The stamp: a small file among the blobs that repeats the database's name for their folder and the database's
//! generation.
//!
//! Its place among the blobs makes a start without their mounted disk detectable. It is written in place: its line is
//! far smaller than a sector, and an unreadable stamp is rejected like a missing one.

use std::{
    fs::{File, OpenOptions},
    io,
    os::unix::fs::FileExt as _,
    path::{Path, PathBuf},
    sync::{Mutex, PoisonError},
};

use serde::{Deserialize, Serialize};

use crate::BLOBS;
use gleaner_core::error::{Error, Result};

/// Name of the stamp within the folder of the blobs.
pub const FILE: &str = "stamp.json";
/// Bytes of the file: a line of JSON, filled up with spaces, so that a new line always covers the one before.
const WIDTH: usize = 192;

/// Content of the stamp.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stamp {
    /// The database's random name for this folder.
    pub folder: String,
    /// The database's generation at the last acknowledged recording or start of the server.
    pub generation: u64,
    /// The inode of the database: a database with another inode is checked before it is used.
    pub inode: u64,
    /// Bytes of the database's file at the last start; a smaller file has lost data.
    #[serde(default)]
    pub bytes: u64,
}

/// The stamp of a data folder, open to be raised.
#[derive(Debug)]
pub struct StampFile {
    path: PathBuf,
    held: Mutex<(File, Stamp)>,
}

/// Path of the stamp of a data folder.
pub fn path(data_dir: &Path) -> PathBuf {
    data_dir.join(BLOBS).join(FILE)
}

impl Stamp {
    /// Reads the stamp of a data folder; `None` when it is missing.
    ///
    /// # Errors
    /// Precondition, with the ways out, when it cannot be read or parsed.
    pub fn read(data_dir: &Path) -> Result<Option<Self>> {
        let path = path(data_dir);
        let unreadable = |problem: String| {
            Error::precondition(format!(
                "{} is not a readable stamp ({problem}). {}",
                path.display(),
                super::ways_out(data_dir)
            ))
        };
        match std::fs::read(&path) {
            Ok(json) => serde_json::from_slice(&json).map(Some).map_err(|error| unreadable(error.to_string())),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(unreadable(error.to_string())),
        }
    }

    fn line(&self) -> Result<Vec<u8>> {
        let mut line = serde_json::to_vec(self).map_err(|error| Error::internal("writing the stamp", error))?;
        line.resize(line.len().max(WIDTH - 1), b' ');
        line.push(b'\n');
        Ok(line)
    }
}

impl StampFile {
    /// Writes the stamp of a data folder, replacing an existing one. The folder of the blobs must exist. A stamp of the
    /// same folder is written in place, which works on a full disk.
    ///
    /// # Errors
    /// Exhausted or Internal when the disk fails.
    pub fn put(data_dir: &Path, stamp: Stamp) -> Result<Self> {
        let path = path(data_dir);
        let before = Stamp::read(data_dir).ok().flatten();
        let same = before.is_some_and(|before| before.folder == stamp.folder);
        let place = if same { path.clone() } else { path.with_extension("draft") };
        let file = OpenOptions::new().create(true).write(true).truncate(false).open(&place);
        let file = file.map_err(|error| fault(&path, error))?;
        write(&file, &stamp).map_err(|error| error.unwrap_or_else(|error| fault(&path, error)))?;
        let renamed = if same { Ok(()) } else { std::fs::rename(&place, &path) };
        let synced = renamed.and_then(|()| File::open(data_dir.join(BLOBS))).and_then(|folder| folder.sync_all());
        synced.map_err(|error| fault(&path, error))?;
        crate::fail_point::pass("stamp.put");
        Ok(Self { path, held: Mutex::new((file, stamp)) })
    }

    /// The content of the stamp.
    pub fn content(&self) -> Stamp {
        self.held.lock().unwrap_or_else(PoisonError::into_inner).1.clone()
    }

    /// Raises the generation on disk; it never falls. Call it after the commit and before the acknowledgement.
    ///
    /// # Errors
    /// Exhausted or Internal when the disk fails.
    pub fn raise(&self, generation: u64) -> Result<()> {
        let mut held = self.held.lock().unwrap_or_else(PoisonError::into_inner);
        let (file, stamp) = &mut *held;
        if generation <= stamp.generation {
            return Ok(());
        }
        let raised = Stamp { generation, ..stamp.clone() };
        write(file, &raised).map_err(|error| error.unwrap_or_else(|error| fault(&self.path, error)))?;
        *stamp = raised;
        crate::fail_point::pass("stamp.raised");
        Ok(())
    }
}

/// Writes a stamp and syncs it. The error is `Ok` with one of this crate, or `Err` with the disk's.
fn write(file: &File, stamp: &Stamp) -> std::result::Result<(), std::result::Result<Error, io::Error>> {
    let line = stamp.line().map_err(Ok)?;
    file.write_all_at(&line, 0).and_then(|()| file.sync_data()).map_err(Err)
}

fn fault(path: &Path, error: io::Error) -> Error {
    Error::internal(format!("writing {}", path.display()), error)
}

#[cfg(test)]
mod tests {
    use super::*;
    use gleaner_core::error::Kind;

    #[test]
    fn the_generation_on_disk_never_falls() {
        let dir = tempfile::tempdir().unwrap();
        std::fs::create_dir(dir.path().join(BLOBS)).unwrap();
        assert_eq!(Stamp::read(dir.path()).unwrap(), None);
        let file =
            StampFile::put(dir.path(), Stamp { folder: "ab".repeat(16), generation: 9, inode: 1, bytes: 0 }).unwrap();
        for (raised, found) in [(10, 10), (8, 10), (u64::MAX, u64::MAX)] {
            file.raise(raised).unwrap();
            assert_eq!(Stamp::read(dir.path()).unwrap().unwrap().generation, found);
        }
        let shorter = Stamp { folder: "cd".to_owned(), generation: 1, inode: 2, bytes: 0 };
        StampFile::put(dir.path(), shorter.clone()).unwrap();
        assert_eq!(Stamp::read(dir.path()).unwrap(), Some(shorter), "no byte of the longer line is left");
    }

    #[test]
    fn an_unreadable_stamp_is_refused_with_the_ways_out() {
        let dir = tempfile::tempdir().unwrap();
        std::fs::create_dir(dir.path().join(BLOBS)).unwrap();
        for content in ["", "{\"folder\":", "\u{0}\u{0}"] {
            std::fs::write(path(dir.path()), content).unwrap();
            let error = Stamp::read(dir.path()).unwrap_err();
            assert_eq!(error.kind(), Kind::Precondition);
            for way in ["restore BACKUP", "rebuild --data-dir"] {
                assert!(error.message().contains(way), "{error}");
            }
        }
    }
}
