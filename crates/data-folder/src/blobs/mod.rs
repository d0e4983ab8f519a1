//! Blobs: immutable files named by the BLAKE3 of their content, in a folder, or in a bucket with copies in the folder.
//!
//! Plain blocking code, because workers use it too; the server calls it off its runtime. Must not depend on rows. A
//! blob is complete or missing: it is written beside its final path, synced, renamed, and its folder synced.

mod across;
mod by_server;
mod calls;
#[cfg(test)]
mod conformance;
mod copies;
mod copy;
mod hold;
mod list;
mod node;
mod place;
mod remote;
mod room;
mod sidecar;
mod space;
mod stream;
#[cfg(test)]
mod tests;
mod trash;

use std::{
    fs::{self, File},
    io,
    path::{Path, PathBuf},
    sync::Arc,
    time::SystemTime,
};

pub use self::{
    across::rename as rename_across_disks,
    calls::{BlobServer, Located, Want},
    copies::Fetched,
    copy::Copied,
    hold::{Copying, Naming, Removing},
    list::Found,
    remote::{has_bucket, settle},
    stream::stream_file,
};
use crate::BLOBS;
use gleaner_core::{
    error::{Error, Result},
    id::BlobId,
};

/// Handle to the blobs of one data directory; clones share it.
#[derive(Debug, Clone)]
pub struct Blobs {
    /// The data directory.
    folder: PathBuf,
    root: PathBuf,
    unfinished: PathBuf,
    naming: Arc<tokio::sync::RwLock<()>>,
    space: space::Space,
    /// The node folder, for copies and decoded steps. `None`: they are in the data directory.
    node: Option<space::Space>,
    /// The way to the bucket that holds the blobs. `None`: the folder does.
    remote: Option<Arc<remote::Remote>>,
}

impl Blobs {
    /// Opens the blobs under `data_dir`, and creates the folders if missing.
    ///
    /// # Errors
    /// Internal when the folders cannot be created; Precondition when drafts are to be in a shared folder; as for
    /// [`Blobs::at`].
    pub fn open(data_dir: &Path) -> Result<Self> {
        Self::at(data_dir)?.prepared()
    }

    /// As [`Blobs::open`], for a process without credentials of the bucket, whose `server` has them. Without a bucket, the
    /// server is not called.
    ///
    /// # Errors
    /// As for [`Blobs::open`].
    pub fn open_by(data_dir: &Path, server: Arc<dyn BlobServer>) -> Result<Self> {
        let remote = has_bucket(data_dir).then(|| Arc::new(remote::Remote::by(server)));
        Self::of(data_dir, remote).prepared()
    }

    fn prepared(self) -> Result<Self> {
        for folder in [&self.root, &self.unfinished] {
            fs::create_dir_all(folder).map_err(fault("making the folder", folder))?;
        }
        crate::access::expect_unshared(&self.unfinished)?;
        sync_folder(&self.folder)?;
        Ok(self)
    }

    /// The blobs of a data directory that is only read: no folder is created.
    ///
    /// # Errors
    /// Precondition when the directory names a bucket and its settings cannot be used.
    pub fn at(data_dir: &Path) -> Result<Self> {
        Ok(Self::of(data_dir, remote::of(data_dir)?))
    }

    fn of(data_dir: &Path, remote: Option<Arc<remote::Remote>>) -> Self {
        let (root, unfinished) = (data_dir.join(BLOBS), data_dir.join("tmp"));
        let space = space::Space::of(data_dir, space::SERVERS_DISK);
        Self { folder: data_dir.to_owned(), root, unfinished, naming: Arc::default(), space, node: None, remote }
    }

    /// The path of a blob, whether or not it exists. With a bucket, the path of its copy.
    pub fn path(&self, id: &BlobId) -> PathBuf {
        let (folder, name) = id.as_str().split_at(2);
        self.root.join(folder).join(name)
    }

    /// Whether the blob exists; false also when its store fails. Where that loses data, [`Blobs::size`] is called.
    pub fn contains(&self, id: &BlobId) -> bool {
        self.size(id).is_ok_and(|size| size.is_some())
    }

    /// The size of a blob; `None` when it is missing.
    ///
    /// # Errors
    /// Unavailable when the store fails; Internal when the disk fails.
    pub fn size(&self, id: &BlobId) -> Result<Option<u64>> {
        if let Some(remote) = &self.remote {
            return self.remote_size(remote, id);
        }
        let path = self.path(id);
        match fs::metadata(&path) {
            Ok(file) => Ok(file.is_file().then_some(file.len())),
            Err(error) if is_missing(&error) => Ok(None),
            Err(error) => Err(fault("reading", &path)(error)),
        }
    }

    /// The number of these blobs that are missing.
    ///
    /// # Errors
    /// As for [`Blobs::size`].
    pub fn count_missing<'a>(&self, ids: impl Iterator<Item = &'a BlobId>) -> Result<usize> {
        if self.remote.is_none() {
            return Ok(ids.filter(|id| !self.contains(id)).count());
        }
        let there: std::collections::HashSet<BlobId> = self.list()?.into_iter().filter_map(|found| found.id).collect();
        Ok(ids.filter(|id| !there.contains(id)).count())
    }

    /// The digest of a stored blob's content, which differs from its name when the blob is damaged.
    ///
    /// # Errors
    /// Damaged when an object is missing; Internal when a file is, or cannot be read; Unavailable when the store fails.
    pub fn digest(&self, id: &BlobId) -> Result<BlobId> {
        match &self.remote {
            Some(remote) => remote.own()?.bucket.digest(&self.name(id)),
            None => digest(&self.path(id)),
        }
    }

    /// The bytes of a blob.
    ///
    /// # Errors
    /// Damaged when it is missing or does not match its name; Unavailable when the store fails.
    pub fn get(&self, id: &BlobId) -> Result<Vec<u8>> {
        let read = |path: &Path| fs::read(path).map_err(|error| unreadable(id, path, error));
        let mut bytes = read(&self.fetched(id)?)?;
        let path = self.copy_path(id);
        if let Some(remote) = self.remote.as_ref().filter(|_| BlobId::from(blake3::hash(&bytes)) != *id) {
            // The copy is damaged, which says nothing of the object.
            self.fetch(remote, id, &path)?;
            bytes = read(&self.fetched(id)?)?;
        }
        if BlobId::from(blake3::hash(&bytes)) != *id {
            let flag = if self.node.is_some() { "--slurm-cache-dir" } else { "--data-dir" };
            return Err(Error::damaged(format!("the file of the blob {id} ({flag}) is damaged: its digest differs")));
        }
        Ok(bytes)
    }

    /// Time of the last [`Self::place`] of a blob; `None` when it is missing.
    ///
    /// # Errors
    /// Unavailable when the store fails.
    pub fn placed(&self, id: &BlobId) -> Result<Option<SystemTime>> {
        match &self.remote {
            Some(remote) => Ok(remote.own()?.bucket.head(&self.name(id))?.map(|found| found.written)),
            None => Ok(fs::metadata(self.path(id)).and_then(|file| file.modified()).ok()),
        }
    }

    /// Removes a blob without a row and returns its size; a missing blob is not an error. The caller has checked the
    /// rows since it took `_removing`.
    ///
    /// # Errors
    /// Internal when the disk fails.
    pub fn remove(&self, id: &BlobId, _removing: &Removing) -> Result<Option<u64>> {
        let (path, size) = (self.path(id), self.size(id)?);
        // The copy first: one without an object is sent again.
        match fs::remove_file(&path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(fault("removing", &path)(error)),
            Ok(()) | Err(_) => {}
        }
        if let Some(remote) = &self.remote {
            remote.own()?.bucket.remove(&self.name(id))?;
        }
        crate::fail_point::pass("blob.removed");
        Ok(size)
    }
}

/// Whether a path has no file, or leads through one.
fn is_missing(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory)
}

/// The BLAKE3 of a file's content.
///
/// # Errors
/// Internal when the file cannot be read.
pub fn digest(path: &Path) -> Result<BlobId> {
    let mut hasher = blake3::Hasher::new();
    File::open(path).and_then(|file| hasher.update_reader(file).map(drop)).map_err(fault("reading", path))?;
    Ok(hasher.finalize().into())
}

/// Syncs a folder: makes its entries durable.
pub fn sync_folder(folder: &Path) -> Result<()> {
    File::open(folder).and_then(|folder| folder.sync_all()).map_err(fault("syncing the folder", folder))
}

fn fault<'a>(doing: &'a str, path: &'a Path) -> impl FnOnce(io::Error) -> Error + 'a {
    move |error| Error::internal(format!("{doing} {}", path.display()), error)
}

/// The error of a blob whose file in the data folder cannot be opened.
fn unreadable(id: &BlobId, path: &Path, error: io::Error) -> Error {
    if is_missing(&error) {
        return Error::damaged(format!("the blob {id} is missing in the data folder (--data-dir)"));
    }
    fault("reading", path)(error)
}

/// Name of the trash among the blobs.
const TRASH: &str = "trash";

/// The paths in a folder; none if it is missing.
fn names(folder: &Path) -> Result<Vec<PathBuf>> {
    match fs::read_dir(folder) {
        Ok(entries) => {
            let paths = entries.map(|entry| entry.map(|entry| entry.path()));
            paths.collect::<io::Result<_>>().map_err(fault("listing", folder))
        }
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(Vec::new()),
        Err(error) => Err(fault("listing", folder)(error)),
    }
}
