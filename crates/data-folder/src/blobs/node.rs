//! A folder of one machine of a cluster, on its own disk: copies of the blobs of a bucket and decoded steps, in place of
//! those in the data folder that all machines share. Its files are bounded together, the least recently used going first.

use std::{
    fs::{self, File},
    io,
    path::{Path, PathBuf},
    time::{Duration, SystemTime},
};

use gleaner_core::{
    error::{Error, Result},
    id::BlobId,
};

use tempfile::NamedTempFile;

use super::{Blobs, across, copies, digest, fault, names, space::Space};
use crate::{CACHE, access::expect_unshared};

/// The subject of messages about its disk.
const NEAR_DISK: &str = "the disk of the node's cache (--slurm-cache-dir)";
/// The suffix of copies, which are limited like files of decoded steps.
const COPY: &str = "copy";
/// The age from which a draft belongs to a process that was killed.
const ABANDONED: Duration = Duration::from_secs(24 * 60 * 60);

impl Blobs {
    /// The same blobs, with their copies and decoded steps in a folder of this machine, which is made if missing. `None`
    /// changes nothing.
    ///
    /// # Errors
    /// Precondition when other programs use the folder too; Internal when it cannot be made or read.
    pub fn caching_in(mut self, folder: Option<&Path>) -> Result<Self> {
        let Some(folder) = folder else { return Ok(self) };
        let cache = folder.join(CACHE);
        fs::create_dir_all(&cache).map_err(fault("making the folder", &cache))?;
        expect_unshared(&cache)?;
        let old = SystemTime::now().checked_sub(ABANDONED).unwrap_or(SystemTime::UNIX_EPOCH);
        for draft in names(&cache)?.into_iter().filter(|path| across::is_draft(path)) {
            if across::is_older(&draft, old).map_err(fault("reading", &draft))? {
                // Another process may remove it too.
                let _ = fs::remove_file(&draft);
            }
        }
        self.near = Some(Space::of(folder, NEAR_DISK));
        Ok(self)
    }

    /// The folder of the decoded steps that this process reads and makes.
    pub fn steps_folder(&self) -> &Path {
        self.near.as_ref().map_or(&self.folder, Space::folder)
    }

    /// The data folder, if decoded steps are read and made elsewhere: it may have files to copy.
    pub fn shared_folder(&self) -> Option<&Path> {
        self.near.as_ref().map(|_| self.folder.as_path())
    }

    /// The path of a blob's copy.
    pub(super) fn copy_path(&self, id: &BlobId) -> PathBuf {
        match &self.near {
            Some(near) => near.folder().join(CACHE).join(format!("{id}.{COPY}")),
            None => self.path(id),
        }
    }

    /// Makes room for a copy.
    pub(super) fn make_copy_space(&self, bytes: u64) -> Result<()> {
        self.near.as_ref().map_or_else(|| self.make_room(bytes), |near| near.make_cache_room(bytes))
    }

    /// Copies a file of decoded steps from the data folder; returns whether there was one.
    ///
    /// # Errors
    /// As for [`Blobs::make_room`]; Internal when the disk fails.
    pub fn copy_steps(&self, from: &Path, to: &Path) -> Result<bool> {
        let Some(draft) = self.copy_of(from, to)? else { return Ok(false) };
        copies::keep(draft, to)?;
        Ok(true)
    }

    /// Copies the server's copy of a blob, if it is still there: the caller fetches it again otherwise.
    ///
    /// # Errors
    /// Damaged when it does not have its digest; as for [`Blobs::make_room`]; Internal when the disk fails.
    pub(super) fn copy_near(&self, id: &BlobId, from: &Path, to: &Path) -> Result<()> {
        let Some(draft) = self.copy_of(from, to)? else { return Ok(()) };
        if digest(draft.path())? != *id {
            let what =
                format!("the copy of the blob {id} in the data folder (--data-dir) is damaged: its digest differs");
            return Err(Error::damaged(what));
        }
        copies::keep(draft, to)
    }

    /// A draft of `to` with the content of `from`; `None` when that is missing.
    fn copy_of(&self, from: &Path, to: &Path) -> Result<Option<NamedTempFile>> {
        let mut file = match File::open(from) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            file => file.map_err(fault("opening", from))?,
        };
        self.make_cache_room(file.metadata().map_err(fault("reading", from))?.len())?;
        let mut draft = self.draft_of(to)?;
        io::copy(&mut file, draft.as_file_mut()).map_err(fault("copying to", to))?;
        Ok(Some(draft))
    }
}
