//! The manifest of a backup, beside its database and its blobs.

use std::{
    fs::{self, File},
    io::{self, Write as _},
    path::{Path, PathBuf},
};

use serde::{Deserialize, Serialize};

use crate::{
    blobs::sync_folder,
    domain::id::BlobId,
    error::{Error, Result},
};

const FILE: &str = "manifest.json";

/// The manifest, written last, when the rest of the backup is complete.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Manifest {
    /// The version of the program.
    pub(super) gleaner: String,
    /// When its database was copied, by the clock of that machine.
    pub(super) made_at: String,
    /// The name of the data folder by its stamp; `None` where no server has used the folder yet, and from earlier
    /// versions.
    #[serde(default)]
    pub(super) folder: Option<String>,
    /// The newest migration of its database.
    pub(super) schema: i64,
    /// The digest of its database.
    pub(super) database: BlobId,
    /// The number of blobs that its database names, and their bytes.
    pub(super) blobs: u64,
    pub(super) bytes: u64,
    /// Blobs named by the database that were missing or damaged in the source.
    pub(super) lacking: Vec<MissingBlob>,
}

/// A blob that could not be backed up.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct MissingBlob {
    pub(super) blob: BlobId,
    pub(super) why: String,
    pub(super) needed_by: Vec<String>,
}

fn path(folder: &Path) -> PathBuf {
    folder.join(FILE)
}

impl Manifest {
    /// The manifest of a folder; `None` when it has none.
    ///
    /// # Errors
    /// Precondition when it cannot be parsed.
    pub(super) fn read(folder: &Path) -> Result<Option<Self>> {
        let path = path(folder);
        match fs::read(&path) {
            Ok(json) => serde_json::from_slice(&json).map(Some).map_err(|error| {
                Error::precondition(format!("{} is not a manifest of a backup: {error}", path.display()))
            }),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(Error::internal(format!("reading {}", path.display()), error)),
        }
    }

    /// Writes it durably.
    pub(super) fn write(&self, folder: &Path) -> Result<()> {
        let (path, draft) = (path(folder), folder.join("tmp").join(FILE));
        let fault = |error: io::Error| Error::internal(format!("writing {}", path.display()), error);
        let json = serde_json::to_vec_pretty(self).map_err(|error| fault(error.into()))?;
        let written = File::create(&draft).and_then(|mut file| {
            file.write_all(&json)?;
            file.sync_all()
        });
        written.and_then(|()| fs::rename(&draft, &path)).map_err(fault)?;
        sync_folder(folder)
    }

    /// Removes it: the database beside it is about to be replaced.
    pub(super) fn remove(folder: &Path) -> Result<()> {
        let path = path(folder);
        match fs::remove_file(&path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => {
                Err(Error::internal(format!("removing {}", path.display()), error))
            }
            Ok(()) | Err(_) => sync_folder(folder),
        }
    }
}
