//! Sidecars: small descriptions beside the blobs, one for each row of a blob, and one for each task. A lost database is
//! rebuilt from them. The caller defines their content; this module names, writes and reads them.

use std::{
    fs,
    io::{self, Write as _},
    path::{Path, PathBuf},
};

use super::{Blobs, across, fault, names, sync_folder};
use gleaner_core::{error::Result, id::BlobId};

/// Folder of the tasks' descriptions, among the blobs.
pub(super) const TASKS: &str = "tasks";
const EXTENSION: &str = "json";

/// Whether a file beside the blobs is a sidecar, or the draft of a sidecar or blob.
pub(super) fn is_one(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension == EXTENSION) || across::is_draft(path)
}

impl Blobs {
    /// Writes the description of the row `id` of `blob` durably.
    ///
    /// # Errors
    /// Exhausted or Internal when the disk fails.
    pub fn describe(&self, blob: &BlobId, id: &str, json: &[u8]) -> Result<()> {
        write(&beside(&self.path(blob), id), json)
    }

    /// Writes the description of a task durably.
    ///
    /// # Errors
    /// Exhausted or Internal when the disk fails.
    pub fn describe_task(&self, id: &str, json: &[u8]) -> Result<()> {
        let folder = self.root.join(TASKS);
        if !folder.is_dir() {
            fs::create_dir_all(&folder).map_err(fault("making the folder", &folder))?;
            sync_folder(&self.root)?;
        }
        write(&folder.join(format!("{id}.{EXTENSION}")), json)
    }

    /// Removes the description of a deleted task; a missing one is not an error.
    ///
    /// # Errors
    /// Internal when the disk fails.
    pub fn forget_task(&self, id: &str) -> Result<()> {
        let folder = self.root.join(TASKS);
        let path = folder.join(format!("{id}.{EXTENSION}"));
        match fs::remove_file(&path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => Err(fault("removing", &path)(error)),
            Ok(()) => sync_folder(&folder),
            Err(_) => Ok(()),
        }
    }

    /// Removes the description of a deleted row; a missing one is not an error.
    ///
    /// # Errors
    /// Internal when the disk fails.
    pub fn forget_description(&self, blob: &BlobId, id: &str) -> Result<()> {
        let path = beside(&self.path(blob), id);
        match fs::remove_file(&path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => Err(fault("removing", &path)(error)),
            Ok(()) => {
                crate::fail_point::pass("sidecar.removed");
                path.parent().map_or(Ok(()), sync_folder)
            }
            Err(_) => Ok(()),
        }
    }

    /// The descriptions of tasks.
    ///
    /// # Errors
    /// Internal when the disk fails.
    pub fn task_descriptions(&self) -> Result<Vec<Vec<u8>>> {
        read_all(names(&self.root.join(TASKS))?.into_iter().filter(|path| is_one(path)))
    }

    /// The descriptions beside a blob and beside its place in the trash: a move between the two may have been
    /// interrupted.
    ///
    /// # Errors
    /// Internal when the disk fails.
    pub fn descriptions(&self, blob: &BlobId) -> Result<Vec<Vec<u8>>> {
        let mut all = read_all(sidecars(&self.path(blob))?.into_iter())?;
        all.extend(read_all(sidecars(&self.trash().path(blob))?.into_iter())?);
        Ok(all)
    }

    /// The description of the row `id` beside a blob.
    pub fn description(&self, blob: &BlobId, id: &str) -> Option<Vec<u8>> {
        fs::read(beside(&self.path(blob), id)).ok()
    }

    /// Whether the blob is described as the row `id`.
    pub fn is_described(&self, blob: &BlobId, id: &str) -> bool {
        beside(&self.path(blob), id).is_file()
    }
}

/// The sidecars of the blob at `place`.
pub(super) fn sidecars(place: &Path) -> Result<Vec<PathBuf>> {
    let (Some(folder), Some(name)) = (place.parent(), place.file_name().and_then(|name| name.to_str())) else {
        return Ok(Vec::new());
    };
    let begins = format!("{name}.");
    let is_of_blob = |path: &PathBuf| {
        let named = path.file_name().and_then(|name| name.to_str());
        is_one(path) && named.is_some_and(|named| named.starts_with(&begins))
    };
    Ok(names(folder)?.into_iter().filter(is_of_blob).collect())
}

fn beside(place: &Path, id: &str) -> PathBuf {
    let name = place.file_name().unwrap_or_default().to_string_lossy();
    place.with_file_name(format!("{name}.{id}.{EXTENSION}"))
}

fn read_all(paths: impl Iterator<Item = PathBuf>) -> Result<Vec<Vec<u8>>> {
    let whole = paths.filter(|path| !across::is_draft(path));
    whole.map(|path| fs::read(&path).map_err(fault("reading", &path))).collect()
}

fn write(path: &Path, json: &[u8]) -> Result<()> {
    if fs::read(path).is_ok_and(|found| found == json) {
        return Ok(());
    }
    let folder = path.parent().unwrap_or(Path::new("."));
    let written = across::draft(folder).and_then(|mut draft| {
        draft.write_all(json)?;
        draft.as_file().sync_all()?;
        draft.persist(path).map_err(|error| error.error)
    });
    written.map_err(fault("writing", path))?;
    crate::fail_point::pass("sidecar.renamed");
    sync_folder(folder)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_row_of_a_blob_has_a_description() {
        let dir = tempfile::tempdir().unwrap();
        let blobs = Blobs::open(dir.path()).unwrap();
        let (one, other) = (blobs.put(b"steps").unwrap(), blobs.put(b"others").unwrap());
        blobs.describe(&one, "ep_a", b"{}").unwrap();
        blobs.describe(&one, "ep_b", b"{\"b\":1}").unwrap();
        blobs.describe(&other, "ep_c", b"{}").unwrap();
        blobs.describe_task("task_a", b"{\"t\":1}").unwrap();
        assert!(blobs.is_described(&one, "ep_a") && !blobs.is_described(&one, "ep_c"));
        let mut found = blobs.descriptions(&one).unwrap();
        found.sort();
        assert_eq!(found, [b"{\"b\":1}".to_vec(), b"{}".to_vec()]);
        assert_eq!(blobs.task_descriptions().unwrap(), [b"{\"t\":1}".to_vec()]);
        assert_eq!(blobs.list().unwrap().len(), 2, "descriptions are not blobs");
        blobs.forget_description(&one, "ep_a").unwrap();
        blobs.forget_description(&one, "ep_a").unwrap();
        assert_eq!(blobs.descriptions(&one).unwrap().len(), 1);
        blobs.forget_task("task_a").unwrap();
        blobs.forget_task("task_a").unwrap();
        assert!(blobs.task_descriptions().unwrap().is_empty());
    }
}
