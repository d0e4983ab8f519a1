//! Stores blobs: a file is complete and synced before it gets its name, and its content is in the bucket before that.

use std::{
    fs::{self, File, FileTimes},
    io::Write as _,
    os::unix::fs::MetadataExt as _,
    path::Path,
    time::SystemTime,
};

use super::{
    Blobs, across, digest, fault,
    remote::{OwnBucket, Remote},
    sync_folder,
};
use gleaner_core::{error::Result, id::BlobId};

impl Blobs {
    /// Stores these bytes durably.
    ///
    /// # Errors
    /// Exhausted when too little of the disk would stay free; Internal when the disk fails.
    pub fn put(&self, bytes: &[u8]) -> Result<BlobId> {
        self.make_room(bytes.len() as u64)?;
        let id = BlobId::from(blake3::hash(bytes));
        let mut file = tempfile::Builder::new()
            .prefix("blob-")
            .tempfile_in(&self.unfinished)
            .map_err(fault("making a file in", &self.unfinished))?;
        file.write_all(bytes).map_err(fault("writing", file.path()))?;
        crate::fail_point::pass("blob.written");
        self.place(&id, file.path())?;
        // The draft has moved: it needs no removal.
        file.disable_cleanup(true);
        Ok(id)
    }

    /// Moves a file of the same file system in; `path` no longer exists afterwards.
    ///
    /// # Errors
    /// Internal when the file cannot be read or the disk fails; then `path` still exists.
    pub fn put_file(&self, path: &Path) -> Result<BlobId> {
        let id = digest(path)?;
        self.place(&id, path)?;
        Ok(id)
    }

    /// Renames a complete file with the digest `id` to its path, replacing a blob of that name, whose content is the
    /// same.
    ///
    /// # Errors
    /// Internal when the disk fails; then `from` still exists.
    pub fn place(&self, id: &BlobId, from: &Path) -> Result<()> {
        self.place_in(id, from, |own, size| {
            // A later failure leaves an object without a row, which the sweep removes.
            own.bucket.put(&self.name(id), from)?;
            self.limit_copies(own, size)
        })
    }

    /// As [`Blobs::place`], where `send` puts the content of the file, of this size, into the bucket.
    pub(super) fn place_in(
        &self,
        id: &BlobId,
        from: &Path,
        send: impl FnOnce(&OwnBucket, u64) -> Result<()>,
    ) -> Result<()> {
        let place = self.path(id);
        let folder = place.parent().unwrap_or(&self.root);
        let file = File::open(from).map_err(fault("opening", from))?;
        // The sweep reads this time: a blob stored a moment ago may have no row yet.
        file.set_times(FileTimes::new().set_modified(SystemTime::now())).map_err(fault("dating", from))?;
        file.sync_all().map_err(fault("syncing", from))?;
        crate::fail_point::pass("blob.synced");
        match self.remote.as_deref() {
            None => {}
            Some(Remote::Server(server)) => return self.hand_over(server, id, from),
            Some(Remote::Bucket(own)) => {
                send(own, file.metadata().map_err(fault("reading", from))?.len())?;
                // The limit of copies reads this time. Sending has set it, by a clock of the system that is behind the one by
                // which copies are used.
                file.set_times(FileTimes::new().set_accessed(SystemTime::now())).map_err(fault("dating", from))?;
            }
        }
        crate::fail_point::pass("blob.in_bucket");
        fs::create_dir_all(folder).map_err(fault("making the folder", folder))?;
        across::rename(from, &place).map_err(fault("renaming to", &place))?;
        // After a crash both may be names of one file; the rename then leaves `from`, which is never the last name.
        if from != place && fs::metadata(from).is_ok_and(|left| left.nlink() > 1) {
            fs::remove_file(from).map_err(fault("removing", from))?;
        }
        crate::fail_point::pass("blob.renamed");
        sync_folder(folder)?;
        crate::fail_point::pass("blob.folder_synced");
        sync_folder(&self.root)
    }
}
