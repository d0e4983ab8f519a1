//! Blobs: immutable files named by the BLAKE3 of their content.
//!
//! Plain blocking code, because workers use it too; the server calls it off its runtime. Must not depend on rows. A
//! blob is complete or missing: it is written beside its final path, synced, renamed, and its folder synced.

mod across;
mod copy;
mod hold;
mod list;
mod sidecar;
mod space;
mod stream;
mod trash;

use std::{
    fs::{self, File},
    io::{self, Write as _},
    os::unix::fs::MetadataExt as _,
    path::{Path, PathBuf},
    sync::Arc,
    time::SystemTime,
};

pub use self::{
    copy::Copied,
    hold::{Copying, Removing},
    list::Found,
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
}

impl Blobs {
    /// Opens the blobs under `data_dir`, and creates the folders if missing.
    ///
    /// # Errors
    /// Internal when the folders cannot be created.
    pub fn open(data_dir: &Path) -> Result<Self> {
        let blobs = Self::at(data_dir);
        for folder in [&blobs.root, &blobs.unfinished] {
            fs::create_dir_all(folder).map_err(fault("making the folder", folder))?;
        }
        sync_folder(data_dir)?;
        Ok(blobs)
    }

    /// The blobs of a data directory that is only read: no folder is created.
    pub fn at(data_dir: &Path) -> Self {
        let (root, unfinished) = (data_dir.join(BLOBS), data_dir.join("tmp"));
        let space = space::Space::of(data_dir);
        Self { folder: data_dir.to_owned(), root, unfinished, naming: Arc::default(), space }
    }

    /// The path of a blob, whether or not it exists.
    pub fn path(&self, id: &BlobId) -> PathBuf {
        let (folder, name) = id.as_str().split_at(2);
        self.root.join(folder).join(name)
    }

    /// Whether the blob exists.
    pub fn contains(&self, id: &BlobId) -> bool {
        self.path(id).is_file()
    }

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
        let place = self.path(id);
        let folder = place.parent().unwrap_or(&self.root);
        let file = File::open(from).map_err(fault("opening", from))?;
        // The sweep reads this time: a blob stored a moment ago may have no row yet.
        file.set_modified(SystemTime::now()).map_err(fault("dating", from))?;
        file.sync_all().map_err(fault("syncing", from))?;
        crate::fail_point::pass("blob.synced");
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

    /// The bytes of a blob.
    ///
    /// # Errors
    /// Internal when it is missing or does not match its name.
    pub fn get(&self, id: &BlobId) -> Result<Vec<u8>> {
        let path = self.path(id);
        let bytes = fs::read(&path).map_err(fault("reading", &path))?;
        if BlobId::from(blake3::hash(&bytes)) != *id {
            return Err(Error::internal(
                format!("reading {}", path.display()),
                "the blob is damaged: its digest differs",
            ));
        }
        Ok(bytes)
    }

    /// Time of the last [`Self::place`] of a blob; `None` when it is missing.
    pub fn placed(&self, id: &BlobId) -> Option<SystemTime> {
        fs::metadata(self.path(id)).and_then(|file| file.modified()).ok()
    }

    /// Removes a blob without a row and returns its size; a missing blob is not an error. The caller has checked the
    /// rows since it took `_removing`.
    ///
    /// # Errors
    /// Internal when the disk fails.
    pub fn remove(&self, id: &BlobId, _removing: &Removing) -> Result<Option<u64>> {
        let path = self.path(id);
        let size = fs::metadata(&path).map(|file| file.len()).ok();
        match fs::remove_file(&path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => Err(fault("removing", &path)(error)),
            Ok(()) | Err(_) => {
                crate::fail_point::pass("blob.removed");
                Ok(size)
            }
        }
    }
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

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<PathBuf> {
        fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect()
    }

    #[test]
    fn equal_content_is_one_file() {
        let dir = tempfile::tempdir().unwrap();
        let blobs = Blobs::open(dir.path()).unwrap();
        let id = blobs.put(b"steps").unwrap();
        let by_file = dir.path().join("upload");
        fs::write(&by_file, b"steps").unwrap();
        assert_eq!(blobs.put(b"steps").unwrap(), id);
        assert_eq!(blobs.put_file(&by_file).unwrap(), id);
        assert!(!by_file.exists());
        assert_eq!(blobs.get(&id).unwrap(), b"steps");
        assert_eq!(names(blobs.path(&id).parent().unwrap()), [blobs.path(&id)]);
        assert!(names(&dir.path().join("tmp")).is_empty());
    }

    #[test]
    fn a_damaged_blob_is_an_error() {
        let dir = tempfile::tempdir().unwrap();
        let blobs = Blobs::open(dir.path()).unwrap();
        let id = blobs.put(b"steps").unwrap();
        fs::write(blobs.path(&id), b"stepz").unwrap();
        assert!(blobs.get(&id).unwrap_err().to_string().contains("damaged"));
        // Storing the content again repairs the blob.
        blobs.put(b"steps").unwrap();
        assert_eq!(blobs.get(&id).unwrap(), b"steps");
    }

    #[test]
    fn an_interrupted_write_is_not_a_blob() {
        let dir = tempfile::tempdir().unwrap();
        let blobs = Blobs::open(dir.path()).unwrap();
        fs::write(dir.path().join("tmp/blob-x"), b"half").unwrap();
        assert!(!blobs.contains(&blake3::hash(b"half").into()));
    }

    #[test]
    fn a_failed_move_keeps_the_file() {
        let dir = tempfile::tempdir().unwrap();
        let blobs = Blobs::open(dir.path()).unwrap();
        let id = BlobId::from(blake3::hash(b"steps"));
        // A file stands where the blob's folder should be.
        fs::write(dir.path().join("blobs").join(&id.as_str()[..2]), b"").unwrap();
        let by_file = dir.path().join("upload");
        fs::write(&by_file, b"steps").unwrap();
        assert!(blobs.put_file(&by_file).is_err());
        assert!(blobs.put(b"steps").is_err());
        assert_eq!(fs::read(&by_file).unwrap(), b"steps");
        assert!(names(&dir.path().join("tmp")).is_empty());
    }

    #[tokio::test]
    async fn removing_twice_is_not_an_error() {
        let dir = tempfile::tempdir().unwrap();
        let blobs = Blobs::open(dir.path()).unwrap();
        let id = blobs.put(b"steps").unwrap();
        let removing = blobs.removing().await.unwrap().unwrap();
        assert_eq!(blobs.remove(&id, &removing).unwrap(), Some(5));
        assert_eq!(blobs.remove(&id, &removing).unwrap(), None);
        assert!(!blobs.contains(&id));
    }
}
