//! Blobs: immutable files named by the BLAKE3 of their content.
//!
//! Plain blocking code, so that workers use it too; the server calls it off its runtime. Knows no row.
//! A blob is there whole or not at all: it is written beside its place, synced, renamed, and its folder synced.

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

pub(crate) use self::{
    copy::Copied,
    hold::{Copying, Removing},
    list::Found,
};
use crate::{
    data_folder::BLOBS,
    domain::id::BlobId,
    error::{Error, Result},
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
    /// Opens the blobs under `data_dir`, and makes the folders if missing.
    ///
    /// # Errors
    /// Internal when the folders cannot be made.
    pub fn open(data_dir: &Path) -> Result<Self> {
        let blobs = Self::at(data_dir);
        for folder in [&blobs.root, &blobs.unfinished] {
            fs::create_dir_all(folder).map_err(fault("making the folder", folder))?;
        }
        sync_folder(data_dir)?;
        Ok(blobs)
    }

    /// The blobs of a data directory that is only looked at: nothing is made.
    pub(crate) fn at(data_dir: &Path) -> Self {
        let (root, unfinished) = (data_dir.join(BLOBS), data_dir.join("tmp"));
        Self { folder: data_dir.to_owned(), root, unfinished, naming: Arc::default(), space: space::Space::default() }
    }

    /// Where a blob is, or would be.
    pub fn path(&self, id: &BlobId) -> PathBuf {
        let (folder, name) = id.as_str().split_at(2);
        self.root.join(folder).join(name)
    }

    /// Whether the blob is there.
    pub fn contains(&self, id: &BlobId) -> bool {
        self.path(id).is_file()
    }

    /// Keeps these bytes; when this returns, they are on disk.
    ///
    /// # Errors
    /// Exhausted when too little of the disk would stay free; Internal when it refuses.
    pub fn put(&self, bytes: &[u8]) -> Result<BlobId> {
        self.expect_room(bytes.len() as u64)?;
        let id = BlobId::from(blake3::hash(bytes));
        let mut file = tempfile::Builder::new()
            .prefix("blob-")
            .tempfile_in(&self.unfinished)
            .map_err(fault("making a file in", &self.unfinished))?;
        file.write_all(bytes).map_err(fault("writing", file.path()))?;
        crate::fail_point::pass("blob.written");
        self.place(&id, file.path())?;
        // It has moved to its place: there is nothing left to clean up.
        file.disable_cleanup(true);
        Ok(id)
    }

    /// Moves a file of the same file system in; `path` is gone afterwards.
    ///
    /// # Errors
    /// Internal when the file cannot be read or the disk refuses; then `path` is still there.
    pub fn put_file(&self, path: &Path) -> Result<BlobId> {
        let id = digest(path)?;
        self.place(&id, path)?;
        Ok(id)
    }

    /// Renames a whole file, whose digest is `id`, to its place: over a blob of that name, that is over the same
    /// content.
    ///
    /// # Errors
    /// Internal when the disk refuses; then `from` is still there.
    pub(crate) fn place(&self, id: &BlobId, from: &Path) -> Result<()> {
        let place = self.path(id);
        let folder = place.parent().unwrap_or(&self.root);
        let file = File::open(from).map_err(fault("opening", from))?;
        // The sweep goes by this: a blob that was put a moment ago is about to be named.
        file.set_modified(SystemTime::now()).map_err(fault("dating", from))?;
        file.sync_all().map_err(fault("syncing", from))?;
        crate::fail_point::pass("blob.synced");
        fs::create_dir_all(folder).map_err(fault("making the folder", folder))?;
        across::rename(from, &place).map_err(fault("renaming to", &place))?;
        // Where both were names of one file already, as after a crash, the move was none. Never the last name.
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
    /// Internal when it is not there or is not what its name says.
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

    /// When a blob was put in its place last; `None` when it is not there.
    pub(crate) fn placed(&self, id: &BlobId) -> Option<SystemTime> {
        fs::metadata(self.path(id)).and_then(|file| file.modified()).ok()
    }

    /// Removes a blob that no row names any more and gives its size; one that is not there is no error. Who holds
    /// `_removing` has asked the rows since.
    ///
    /// # Errors
    /// Internal when the disk refuses.
    pub(crate) fn remove(&self, id: &BlobId, _removing: &Removing) -> Result<Option<u64>> {
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

/// Makes the names in a folder as durable as the files' contents.
pub(crate) fn sync_folder(folder: &Path) -> Result<()> {
    File::open(folder).and_then(|folder| folder.sync_all()).map_err(fault("syncing the folder", folder))
}

fn fault<'a>(doing: &'a str, path: &'a Path) -> impl FnOnce(io::Error) -> Error + 'a {
    move |error| Error::internal(format!("{doing} {}", path.display()), error)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<PathBuf> {
        fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect()
    }

    #[test]
    fn the_same_content_twice_is_one_file() {
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
    fn damage_is_told_not_served() {
        let dir = tempfile::tempdir().unwrap();
        let blobs = Blobs::open(dir.path()).unwrap();
        let id = blobs.put(b"steps").unwrap();
        fs::write(blobs.path(&id), b"stepz").unwrap();
        assert!(blobs.get(&id).unwrap_err().to_string().contains("damaged"));
        // Putting it again mends it.
        blobs.put(b"steps").unwrap();
        assert_eq!(blobs.get(&id).unwrap(), b"steps");
    }

    #[test]
    fn a_write_that_a_crash_cut_is_not_a_blob() {
        let dir = tempfile::tempdir().unwrap();
        let blobs = Blobs::open(dir.path()).unwrap();
        fs::write(dir.path().join("tmp/blob-x"), b"half").unwrap();
        assert!(!blobs.contains(&blake3::hash(b"half").into()));
    }

    #[test]
    fn a_refused_move_keeps_the_file() {
        let dir = tempfile::tempdir().unwrap();
        let blobs = Blobs::open(dir.path()).unwrap();
        let id = BlobId::from(blake3::hash(b"steps"));
        // Something else stands where the blob's folder should be.
        fs::write(dir.path().join("blobs").join(&id.as_str()[..2]), b"").unwrap();
        let by_file = dir.path().join("upload");
        fs::write(&by_file, b"steps").unwrap();
        assert!(blobs.put_file(&by_file).is_err());
        assert!(blobs.put(b"steps").is_err());
        assert_eq!(fs::read(&by_file).unwrap(), b"steps");
        assert!(names(&dir.path().join("tmp")).is_empty());
    }

    #[tokio::test]
    async fn removing_twice_is_no_error() {
        let dir = tempfile::tempdir().unwrap();
        let blobs = Blobs::open(dir.path()).unwrap();
        let id = blobs.put(b"steps").unwrap();
        let removing = blobs.removing().await.unwrap().unwrap();
        assert_eq!(blobs.remove(&id, &removing).unwrap(), Some(5));
        assert_eq!(blobs.remove(&id, &removing).unwrap(), None);
        assert!(!blobs.contains(&id));
    }
}
