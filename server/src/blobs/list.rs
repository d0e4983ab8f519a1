//! What lies in the blobs' folders, whether or not a row names it.

use std::{
    fs,
    path::{Path, PathBuf},
    time::SystemTime,
};

use super::{Blobs, fault};
use crate::{domain::id::BlobId, error::Result};

/// A file among the blobs.
#[derive(Debug)]
pub(crate) struct Found {
    /// Which blob; `None` when it has no blob's name.
    pub(crate) id: Option<BlobId>,
    pub(crate) path: PathBuf,
    pub(crate) size_bytes: u64,
    /// When it was put there last.
    pub(crate) placed: SystemTime,
}

impl Blobs {
    /// Every file among the blobs; one that goes meanwhile is left out.
    ///
    /// # Errors
    /// When the folders cannot be read.
    pub(crate) fn list(&self) -> Result<Vec<Found>> {
        let mut found = Vec::new();
        for folder in names(&self.root)? {
            if !folder.is_dir() {
                found.extend(look(folder, None)?);
                continue;
            }
            for path in names(&folder)? {
                let id = self.named(&path);
                found.extend(look(path, id)?);
            }
        }
        Ok(found)
    }

    /// The blob whose place this is.
    fn named(&self, path: &Path) -> Option<BlobId> {
        let (folder, name) = (path.parent()?.file_name()?.to_str()?, path.file_name()?.to_str()?);
        BlobId::try_from(format!("{folder}{name}")).ok().filter(|id| self.path(id) == path)
    }
}

fn names(folder: &Path) -> Result<Vec<PathBuf>> {
    match fs::read_dir(folder) {
        Ok(entries) => {
            let paths = entries.map(|entry| entry.map(|entry| entry.path()));
            paths.collect::<std::io::Result<_>>().map_err(fault("listing", folder))
        }
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(Vec::new()),
        Err(error) => Err(fault("listing", folder)(error)),
    }
}

fn look(path: PathBuf, id: Option<BlobId>) -> Result<Option<Found>> {
    let seen = fs::symlink_metadata(&path).and_then(|file| Ok((file.len(), file.modified()?)));
    match seen {
        Ok((size_bytes, placed)) => Ok(Some(Found { id, path, size_bytes, placed })),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(fault("reading", &path)(error)),
    }
}
