//! Lists the files in the blobs' folders, with or without a row. Sidecars, the stamp and the trash are not blobs.

use std::{
    fs, io,
    path::{Path, PathBuf},
    sync::Arc,
    time::SystemTime,
};

use super::{
    Blobs, across, fault, names,
    remote::{self, Remote},
    sidecar,
};
use crate::stamp;
use gleaner_core::{error::Result, id::BlobId};

/// A file among the blobs.
#[derive(Debug)]
pub struct Found {
    /// Its id; `None` when its name is not a blob's.
    pub id: Option<BlobId>,
    /// Its path.
    pub path: PathBuf,
    /// Its size in bytes.
    pub size_bytes: u64,
    /// Time of the last [`Blobs::place`].
    pub placed: SystemTime,
    /// Its name in the bucket that holds it.
    object: Option<(Arc<Remote>, String)>,
}

impl Found {
    /// The digest of its content.
    ///
    /// # Errors
    /// Internal when it cannot be read; Unavailable when the store fails.
    pub fn digest(&self) -> Result<BlobId> {
        match &self.object {
            Some((remote, name)) => remote.own()?.bucket.digest(name),
            None => super::digest(&self.path),
        }
    }

    /// Whether the file begins with these bytes; false when it cannot be read.
    pub fn begins_with(&self, bytes: &[u8]) -> bool {
        if let Some((remote, name)) = &self.object {
            let read = remote.own().and_then(|own| own.bucket.beginning(name, bytes.len() as u64));
            return read.is_ok_and(|found| found == bytes);
        }
        let mut found = vec![0; bytes.len()];
        let read = fs::File::open(&self.path).and_then(|mut file| io::Read::read_exact(&mut file, &mut found));
        read.is_ok() && found == bytes
    }
}

impl Blobs {
    /// Every file among the blobs; files removed during the listing are left out.
    ///
    /// # Errors
    /// When the folders cannot be read.
    pub fn list(&self) -> Result<Vec<Found>> {
        if let Some(remote) = &self.remote {
            return self.list_objects(remote);
        }
        let mut found = Vec::new();
        for path in names(&self.root)? {
            match path.file_name().and_then(|name| name.to_str()) {
                Some(name) if is_hex(name) => self.list_folder(&path, &mut found)?,
                // A file system mounted among the blobs has folders of its own there, such as `lost+found`.
                Some(_) | None if path.is_dir() => {}
                Some(stamp::FILE) => {}
                Some(_) | None => found.extend(look(path, None)?),
            }
        }
        Ok(found)
    }

    /// Whether the folder holds neither blob, sidecar nor stamp, and its trash is empty.
    ///
    /// # Errors
    /// When the folders cannot be read.
    pub fn is_empty(&self) -> Result<bool> {
        if let Some(remote) = &self.remote
            && !remote.own()?.bucket.list(crate::BLOBS)?.is_empty()
        {
            return Ok(false);
        }
        for path in names(&self.root)? {
            let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
            let ours = is_hex(name) || [sidecar::TASKS, super::TRASH].contains(&name);
            if !path.is_dir() || (ours && !names(&path)?.is_empty()) {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// Removes the blobs' drafts made and last written before `time`, which killed processes left, and returns their number.
    ///
    /// # Errors
    /// When the folders cannot be read.
    pub fn remove_drafts(&self, time: SystemTime) -> Result<u64> {
        let mut removed = 0;
        let hex = |path: &PathBuf| path.file_name().and_then(|name| name.to_str()).is_some_and(is_hex);
        let tasks = self.root.join(sidecar::TASKS);
        for folder in names(&self.root)?.into_iter().filter(hex).chain([tasks]) {
            removed += remove_drafts(&folder, time)?;
        }
        Ok(removed)
    }

    /// The objects of the blobs; of a bucket, others are left alone.
    fn list_objects(&self, remote: &Arc<Remote>) -> Result<Vec<Found>> {
        let listed = remote.own()?.bucket.list(&remote::name(&self.folder, &self.root))?;
        let found = listed.into_iter().filter_map(|object| {
            let path = self.folder.join(&object.name);
            let id = Some(self.named(&path)?);
            let (size_bytes, placed) = (object.size_bytes, object.written);
            Some(Found { id, path, size_bytes, placed, object: Some((Arc::clone(remote), object.name)) })
        });
        Ok(found.collect())
    }

    fn list_folder(&self, folder: &Path, found: &mut Vec<Found>) -> Result<()> {
        for path in names(folder)? {
            if !sidecar::is_one(&path) {
                let id = self.named(&path);
                found.extend(look(path, id)?);
            }
        }
        Ok(())
    }

    /// The blob of this path.
    fn named(&self, path: &Path) -> Option<BlobId> {
        let (folder, name) = (path.parent()?.file_name()?.to_str()?, path.file_name()?.to_str()?);
        BlobId::try_from(format!("{folder}{name}")).ok().filter(|id| self.path(id) == path)
    }
}

fn is_hex(name: &str) -> bool {
    name.len() == 2 && name.bytes().all(|digit| digit.is_ascii_hexdigit())
}

fn look(path: PathBuf, id: Option<BlobId>) -> Result<Option<Found>> {
    let seen = fs::symlink_metadata(&path).and_then(|file| Ok((file.len(), file.modified()?)));
    match seen {
        Ok((size_bytes, placed)) => Ok(Some(Found { id, path, size_bytes, placed, object: None })),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(fault("reading", &path)(error)),
    }
}

/// Removes the drafts in a folder that were made and last written before `time`, and returns their number.
pub(super) fn remove_drafts(folder: &Path, time: SystemTime) -> Result<u64> {
    let mut removed = 0;
    for draft in names(folder)?.into_iter().filter(|path| across::is_draft(path)) {
        if across::is_older(&draft, time).map_err(fault("reading", &draft))? {
            match fs::remove_file(&draft) {
                // Another process has removed it.
                Err(error) if error.kind() == io::ErrorKind::NotFound => {}
                gone => gone.map(|()| removed += 1).map_err(fault("removing", &draft))?,
            }
        }
    }
    Ok(removed)
}
