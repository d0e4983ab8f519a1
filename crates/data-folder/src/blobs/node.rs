//! The node folder: a folder on one machine's own disk for decoded steps and copies of the blobs of a bucket, in place of
//! those in the data folder that all nodes of a cluster share. Its files have one limit together, by which the least recently
//! used go first. Where it is full, the data folder is used.

use std::{
    fs::{self, File},
    io,
    os::unix::fs::MetadataExt as _,
    path::{Path, PathBuf},
    time::{Duration, SystemTime},
};

use gleaner_core::{
    error::{Error, Result},
    id::BlobId,
};
use rustix::process::geteuid;
use tempfile::NamedTempFile;

use super::{Blobs, copies, digest, fault, list::remove_drafts, space::Space};
use crate::{
    CACHE,
    access::{expect_unshared, make_private_folder},
};

/// The subject of messages about its disk.
const NODE_DISK: &str = "the disk of the node folder (--slurm-cache-dir)";
/// The suffix of copies, which are limited like files of decoded steps.
const COPY: &str = "copy";
/// The age from which a draft belongs to a process that was killed.
const ABANDONED: Duration = Duration::from_secs(24 * 60 * 60);
/// The bits of a folder's mode by which others than its owner may change it.
const OTHERS_WRITE: u32 = 0o022;

impl Blobs {
    /// The same blobs with a node folder, which is made if it is missing.
    ///
    /// # Errors
    /// Precondition when others may write to the folder; Internal when it cannot be made or read.
    pub fn caching_in(&self, folder: &Path) -> Result<Self> {
        let cache = folder.join(CACHE);
        make_private_folder(&cache).map_err(fault("making the folder", &cache))?;
        expect_unshared(&cache)?;
        let found = fs::metadata(&cache).map_err(fault("reading the folder", &cache))?;
        if found.uid() != geteuid().as_raw() || found.mode() & OTHERS_WRITE != 0 {
            return Err(Error::precondition(format!(
                "other users may write to {}, and jobs would learn from what they write: use a folder that only the user of \
                 gleaner's jobs may write to",
                cache.display()
            )));
        }
        let now = SystemTime::now();
        remove_drafts(&cache, now.checked_sub(ABANDONED).unwrap_or(SystemTime::UNIX_EPOCH))?;
        Ok(Self { node: Some(Space::of(folder, NODE_DISK)), ..self.clone() })
    }

    /// The same blobs without the node folder, if they have one.
    pub fn without_node_folder(&self) -> Option<Self> {
        self.node.as_ref().map(|_| Self { node: None, ..self.clone() })
    }

    /// The folder of the decoded steps that this process reads and makes.
    pub fn steps_folder(&self) -> &Path {
        self.node.as_ref().map_or(&self.folder, Space::folder)
    }

    /// The path of a blob's copy.
    pub(super) fn copy_path(&self, id: &BlobId) -> PathBuf {
        match &self.node {
            Some(node) => node.folder().join(CACHE).join(format!("{id}.{COPY}")),
            None => self.path(id),
        }
    }

    /// Makes room for a copy.
    pub(super) fn make_copy_room_here(&self, bytes: u64) -> Result<()> {
        self.node.as_ref().map_or_else(|| self.make_room(bytes), |node| node.make_cache_room(bytes))
    }

    /// Copies a file of decoded steps from the data folder to the node folder; returns whether there was one.
    ///
    /// # Errors
    /// As for [`Blobs::make_room`]; Internal when the disk fails.
    pub fn copy_steps(&self, from: &Path, to: &Path) -> Result<bool> {
        let Some(draft) = self.copy_of(from, to)? else { return Ok(false) };
        copies::keep(draft, to)?;
        Ok(true)
    }

    /// Copies the server's copy of a blob to the node folder, if it is still there: the caller fetches it again otherwise.
    ///
    /// # Errors
    /// Damaged when it does not have its digest; as for [`Blobs::make_room`]; Internal when the disk fails.
    pub(super) fn copy_to_node(&self, id: &BlobId, from: &Path, to: &Path) -> Result<()> {
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
