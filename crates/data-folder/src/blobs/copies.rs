//! The copies in the data folder of blobs that a bucket holds: fetched when they are missing, and removed, the least
//! recently used first, above their limit.

use std::{
    fs::{self, File, FileTimes},
    io,
    path::{Path, PathBuf},
    sync::PoisonError,
    time::{Duration, Instant, SystemTime},
};

use gleaner_core::{
    error::{Error, Kind, Result},
    id::BlobId,
};
use tempfile::{NamedTempFile, TempPath};

use super::{
    Blobs, across, digest, fault,
    hold::Naming,
    remote::{self, OwnBucket, Remote},
    unreadable,
};

/// The time for which a listing of the copies is used. Other processes fetch copies too.
const LISTING_LASTS: Duration = Duration::from_secs(60);

/// The most times that a copy is fetched for one reader.
const ATTEMPTS: usize = 5;

/// The path of a blob's file, which exists at least as long as this value: of a copy, it is a second name, so that the
/// copy can be removed meanwhile.
#[derive(Debug)]
pub struct Fetched {
    path: PathBuf,
    _link: Option<TempPath>,
}

impl From<PathBuf> for Fetched {
    /// A file that nothing else removes.
    fn from(path: PathBuf) -> Self {
        Self { path, _link: None }
    }
}

impl std::ops::Deref for Fetched {
    type Target = Path;

    fn deref(&self) -> &Path {
        &self.path
    }
}

impl AsRef<Path> for Fetched {
    fn as_ref(&self) -> &Path {
        &self.path
    }
}

impl Blobs {
    /// The file of a blob, which is fetched from the bucket if it is missing.
    ///
    /// # Errors
    /// Damaged when the object, or the file without a bucket, is missing, or the object is damaged; Internal when its copies
    /// are removed as fast as they are fetched; Unavailable when the store fails; Exhausted when the disk is full.
    pub fn fetched(&self, id: &BlobId) -> Result<Fetched> {
        let Some(remote) = &self.remote else {
            let path = self.path(id);
            fs::metadata(&path).map_err(|error| unreadable(id, &path, error))?;
            return Ok(path.into());
        };
        let path = self.copy_path(id);
        for _ in 0..ATTEMPTS {
            match File::open(&path) {
                // Without it, the copy looks older than it is.
                Ok(file) => drop(file.set_times(FileTimes::new().set_accessed(SystemTime::now()))),
                Err(_) => match (self.fetch(remote, id, &path), self.without_node_folder()) {
                    (Err(error), Some(shared)) if error.kind() == Kind::Exhausted => {
                        tracing::warn!(%error, "a copy is made in the data folder");
                        return shared.fetched(id);
                    }
                    (fetched, _) => fetched?,
                },
            }
            match across::link(&path) {
                Ok(link) => return Ok(Fetched { path: link.to_path_buf(), _link: Some(link) }),
                // Nothing removes copies from a folder that is only read.
                Err(error) if error.kind() == io::ErrorKind::ReadOnlyFilesystem => {
                    return Ok(path.into());
                }
                // The copy was removed for others' sake.
                Err(error) if error.kind() == io::ErrorKind::NotFound => {}
                Err(error) => return Err(fault("linking", &path)(error)),
            }
        }
        let found = "its copy was removed each time before it could be opened; raise --blob-cache-bytes, and check that \
                     --data-dir is the same folder on every node of a cluster";
        Err(Error::internal(format!("opening {}", path.display()), found))
    }

    /// Puts the content of a file into the bucket, if there is one, so that [`Blobs::place_sent`] has little to do
    /// while it holds a lock.
    ///
    /// # Errors
    /// Unavailable when the store fails; Internal when the file cannot be read.
    pub fn send(&self, id: &BlobId, from: &Path) -> Result<()> {
        match self.remote.as_deref() {
            Some(Remote::Bucket(own)) => own.bucket.put(&self.name(id), from),
            // The server stores it when it is placed.
            Some(Remote::Server(_)) | None => Ok(()),
        }
    }

    /// As [`Blobs::place`], of a file that [`Blobs::send`] has sent: it is not sent again unless its object was removed
    /// meanwhile. The caller names the blob while it holds `_naming`.
    ///
    /// # Errors
    /// As for [`Blobs::place`].
    pub fn place_sent(&self, id: &BlobId, from: &Path, _naming: &Naming) -> Result<()> {
        self.place_in(id, from, |own, size| {
            if own.bucket.size(&self.name(id))? != Some(size) {
                own.bucket.put(&self.name(id), from)?;
            }
            self.limit_copies(own, size)
        })
    }

    /// Sends the object of a blob again from its copy, whatever the bucket holds, and returns whether there was a sound copy;
    /// never without a bucket of this process.
    ///
    /// # Errors
    /// Unavailable when the store fails.
    pub fn resend(&self, id: &BlobId) -> Result<bool> {
        let (Some(Remote::Bucket(own)), path) = (self.remote.as_deref(), self.path(id)) else { return Ok(false) };
        if digest(&path).ok().as_ref() != Some(id) {
            return Ok(false);
        }
        own.bucket.put(&self.name(id), &path)?;
        tracing::error!(blob.id = %id, store = own.bucket.shown(), "the bucket had lost a blob, or a part of it: sent again");
        Ok(true)
    }

    /// Removes the copy of a blob that a reader could not use, if the copy is damaged and the bucket has the object. Returns
    /// whether the next reader fetches the blob again; never without a bucket.
    ///
    /// # Errors
    /// Unavailable when the store fails; Internal when the disk fails.
    pub fn drop_damaged_copy(&self, id: &BlobId) -> Result<bool> {
        let (Some(remote), path) = (&self.remote, self.copy_path(id)) else { return Ok(false) };
        // A part that the disk cannot read is damage too.
        if digest(&path).ok().as_ref() == Some(id) || self.remote_size(remote, id)?.is_none() {
            return Ok(false);
        }
        match fs::remove_file(&path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(fault("removing", &path)(error)),
            Ok(()) | Err(_) => {}
        }
        tracing::error!(blob.id = %id, file.path = %path.display(), "a damaged copy was removed; the bucket has the blob");
        Ok(true)
    }

    /// As [`Blobs::fetched`], from the bucket alone.
    pub(super) fn fetch(&self, remote: &Remote, id: &BlobId, path: &Path) -> Result<()> {
        let own = match remote {
            Remote::Bucket(own) => own,
            Remote::Server(server) => return self.fetch_by(server, id, path),
        };
        let name = self.name(id);
        if let Some(size) = own.bucket.size(&name)? {
            self.limit_copies(own, size)?;
            self.make_room(size)?;
        }
        let draft = self.draft_of(path)?;
        own.bucket.fetch(&name, id, draft.as_file())?;
        keep(draft, path)
    }

    /// A draft of a copy beside its path.
    pub(super) fn draft_of(&self, path: &Path) -> Result<NamedTempFile> {
        let folder = path.parent().unwrap_or(&self.root);
        fs::create_dir_all(folder).map_err(fault("making the folder", folder))?;
        across::draft(folder).map_err(fault("making a file in", folder))
    }

    /// The size of a blob of a bucket; `None` when it is missing.
    pub(super) fn remote_size(&self, remote: &Remote, id: &BlobId) -> Result<Option<u64>> {
        match remote {
            Remote::Bucket(own) => own.bucket.size(&self.name(id)),
            Remote::Server(server) => server.size(id),
        }
    }

    /// Removes the least recently used copies until `bytes` more fit below the limit. A copy whose object is missing or has
    /// another size stays, and its object is sent again.
    pub(super) fn limit_copies(&self, own: &OwnBucket, bytes: u64) -> Result<()> {
        if own.most_bytes == 0 {
            return Ok(());
        }
        let mut copies = own.copies.lock().unwrap_or_else(PoisonError::into_inner);
        let known =
            copies.filter(|(there, at)| at.elapsed() < LISTING_LASTS && there.saturating_add(bytes) <= own.most_bytes);
        let mut there = match known {
            Some((there, _)) => there,
            None => self.evict(own, bytes)?,
        };
        there = there.saturating_add(bytes);
        *copies = Some((there, known.map_or_else(Instant::now, |(_, at)| at)));
        Ok(())
    }

    /// Removes copies until `bytes` more fit and a tenth of the limit is free, so that the next calls need no listing.
    fn evict(&self, own: &OwnBucket, bytes: u64) -> Result<u64> {
        let here = Self { remote: None, ..self.clone() };
        let mut files: Vec<_> = here
            .list()?
            .into_iter()
            .filter_map(|found| {
                let used = fs::metadata(&found.path).and_then(|file| file.accessed()).ok()?;
                found.id.map(|id| (used, found.size_bytes, id, found.path))
            })
            .collect();
        files.sort();
        let mut there: u64 = files.iter().map(|(_, size, ..)| size).sum();
        if there.saturating_add(bytes) <= own.most_bytes {
            return Ok(there);
        }
        let most = own.most_bytes - own.most_bytes / 10;
        for (_, size, id, path) in files {
            if there.saturating_add(bytes) <= most {
                break;
            }
            let object = own.bucket.size(&self.name(&id))?;
            if object != Some(size) && path.exists() && self.must_stay(own, &id, object) {
                continue;
            }
            match fs::remove_file(&path) {
                Err(error) if error.kind() != io::ErrorKind::NotFound => {
                    return Err(fault("removing", &path)(error));
                }
                Ok(()) | Err(_) => there -= size,
            }
        }
        Ok(there)
    }

    /// Sends an object that is missing or has another size (`object`) again from its copy, if that is sound. Returns whether
    /// the copy has to stay.
    fn must_stay(&self, own: &OwnBucket, id: &BlobId, object: Option<u64>) -> bool {
        let store = own.bucket.shown();
        match self.resend(id) {
            Ok(true) => true,
            Ok(false) => {
                tracing::error!(blob.id = %id, store, object, "a copy is damaged, and its object is missing or has another size");
                object.is_none()
            }
            Err(error) => {
                tracing::error!(blob.id = %id, store, object, %error, "the bucket lacks a blob: its copy stays");
                true
            }
        }
    }

    /// The name of a blob in its bucket.
    pub(super) fn name(&self, id: &BlobId) -> String {
        remote::name(&self.folder, &self.path(id))
    }
}

/// Gives a complete draft of a copy its name.
pub(super) fn keep(draft: NamedTempFile, path: &Path) -> Result<()> {
    // After a power cut a name must not lead to a part of the content.
    draft.as_file().sync_all().map_err(fault("syncing", path))?;
    draft.persist(path).map_err(|error| fault("renaming to", path)(error.error))?;
    Ok(())
}
