//! The trash of blobs: blobs without a row move there with their sidecars and stay there for the retention time of the
//! trash. The folder is beside the blobs, so a move is a rename on one disk.

use std::{
    fs::{self, File},
    io,
    path::Path,
    time::SystemTime,
};

use super::{Blobs, Found, Removing, TRASH, across, fault, sidecar, sync_folder};
use gleaner_core::{error::Result, id::BlobId};

impl Blobs {
    /// The blobs in the trash, with the layout of the blobs themselves.
    pub(super) fn trash(&self) -> Self {
        Self { root: self.root.join(TRASH), ..self.clone() }
    }

    /// Moves a blob without a row to the trash, with its sidecars, and returns its size; a missing blob is not an
    /// error. The caller has checked the rows since it took `_removing`.
    ///
    /// # Errors
    /// Internal when the disk fails.
    pub fn discard(&self, id: &BlobId, _removing: &Removing) -> Result<Option<u64>> {
        self.move_blob(id, &self.trash())
    }

    /// Restores a blob and its sidecars from the trash; true when the blob was there.
    ///
    /// # Errors
    /// Internal when the disk fails.
    pub fn take_back(&self, id: &BlobId) -> Result<bool> {
        self.trash().move_blob(id, self).map(|size| size.is_some())
    }

    /// Moves a blob that has no row to a path outside the blobs, on any disk, and removes its sidecars.
    ///
    /// # Errors
    /// Internal when the disk fails; then the blob is in one of the two places.
    pub fn move_out(&self, id: &BlobId, to: &Path) -> Result<()> {
        let from = self.path(id);
        if let Some(remote) = &self.remote {
            // The object is removed: what leaves is its checked content, and not the copy.
            self.fetch(remote, id, &from)?;
        }
        across::rename(&from, to).map_err(fault("renaming to", to))?;
        if let Some(remote) = &self.remote {
            to.parent().map_or(Ok(()), sync_folder)?;
            remote.own()?.bucket.remove(&self.name(id))?;
        }
        sidecar::sidecars(&from)?.iter().try_for_each(|sidecar| remove(sidecar))
    }

    /// Every blob in the trash.
    ///
    /// # Errors
    /// When the folders cannot be read.
    pub fn list_trash(&self) -> Result<Vec<Found>> {
        self.trash().list()
    }

    /// Deletes the blobs that moved to the trash before `time` and for which `stays`, given their descriptions, is
    /// false. Returns the number of blobs and of bytes.
    ///
    /// # Errors
    /// Internal when the disk fails.
    pub fn empty_trash(&self, time: SystemTime, stays: impl Fn(&Found, &[Vec<u8>]) -> bool) -> Result<(u64, u64)> {
        let (mut blobs, mut bytes) = (0, 0);
        for found in self.list_trash()?.into_iter().filter(|found| found.placed < time) {
            // A blob whose name or descriptions cannot be read is left for manual inspection.
            let Some(Ok(described)) = found.id.as_ref().map(|id| self.descriptions(id)) else { continue };
            if stays(&found, &described) {
                continue;
            }
            if let (Some(remote), Some(id)) = (&self.remote, &found.id) {
                remote.own()?.bucket.remove(&self.trash().name(id))?;
            }
            remove(&found.path)?;
            for sidecar in sidecar::sidecars(&found.path)? {
                remove(&sidecar)?;
            }
            crate::fail_point::pass("trash.blob_deleted");
            (blobs, bytes) = (blobs + 1, bytes + found.size_bytes);
        }
        Ok((blobs, bytes))
    }

    /// Moves the sidecars and syncs them before it moves the blob. Readers look at both places.
    fn move_blob(&self, id: &BlobId, to: &Self) -> Result<Option<u64>> {
        let (from, place) = (self.path(id), to.path(id));
        let folder = place.parent().unwrap_or(&to.root);
        let Some(size) = self.size(id)? else { return Ok(None) };
        fs::create_dir_all(folder).map_err(fault("making the folder", folder))?;
        for sidecar in sidecar::sidecars(&from)? {
            let there = folder.join(sidecar.file_name().unwrap_or_default());
            fs::rename(&sidecar, &there).map_err(fault("renaming to", &there))?;
        }
        for folder in [Some(folder), folder.parent(), Some(self.root.as_path()), Some(to.root.as_path())] {
            folder.map_or(Ok(()), sync_folder)?;
        }
        crate::fail_point::pass("trash.sidecars_moved");
        if let Some(remote) = &self.remote {
            // A copy in the trash would be of no use. Until the object is there, it may be the last one: if it is sent again
            // meanwhile, the sweep finds a blob without a row.
            remote.own()?.bucket.rename(&self.name(id), &to.name(id))?;
            remove(&from)?;
        } else {
            // The retention time in the trash starts now.
            let dated = File::open(&from).and_then(|file| file.set_modified(SystemTime::now()));
            dated.map_err(fault("dating", &from))?;
            fs::rename(&from, &place).map_err(fault("renaming to", &place))?;
        }
        crate::fail_point::pass("trash.moved");
        sync_folder(folder)?;
        from.parent().map_or(Ok(()), sync_folder)?;
        Ok(Some(size))
    }
}

fn remove(path: &Path) -> Result<()> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(fault("removing", path)(error)),
        Ok(()) | Err(_) => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[tokio::test]
    async fn a_discarded_blob_comes_back_with_its_description_until_its_days_are_over() {
        let dir = tempfile::tempdir().unwrap();
        let blobs = Blobs::open(dir.path()).unwrap();
        let id = blobs.put(b"steps").unwrap();
        blobs.describe(&id, "ep_a", b"{}").unwrap();
        let removing = blobs.removing().await.unwrap().unwrap();
        assert_eq!(blobs.discard(&id, &removing).unwrap(), Some(5));
        assert_eq!(blobs.discard(&id, &removing).unwrap(), None);
        assert!(!blobs.contains(&id) && blobs.list().unwrap().is_empty());
        assert_eq!(blobs.list_trash().unwrap().len(), 1);
        assert!(blobs.take_back(&id).unwrap() && !blobs.take_back(&id).unwrap());
        assert!(blobs.get(&id).is_ok() && blobs.is_described(&id, "ep_a"));
        blobs.discard(&id, &removing).unwrap();
        let hour = Duration::from_secs(3600);
        let (before, after) = (SystemTime::now() - hour, SystemTime::now() + hour);
        assert_eq!(blobs.empty_trash(before, |_, _| false).unwrap(), (0, 0));
        assert_eq!(blobs.empty_trash(after, |_, described| described == [b"{}"]).unwrap(), (0, 0));
        assert_eq!(blobs.empty_trash(after, |_, _| false).unwrap(), (1, 5));
        assert!(blobs.list_trash().unwrap().is_empty() && !blobs.take_back(&id).unwrap());
    }
}
