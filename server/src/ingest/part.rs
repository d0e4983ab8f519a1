//! The part file of one upload: appended to by its claim holder, synced before bytes are acknowledged.

use std::{
    fs::File,
    io::{self, Read as _, Seek as _, SeekFrom, Write as _},
    os::unix::fs::MetadataExt as _,
    path::{Path, PathBuf},
};

use bytes::Bytes;

use super::{claim::Claim, off_runtime};
use crate::{
    blobs::sync_folder,
    error::{Error, Result},
};

/// An open part file. It holds the claim, so that a write which outlives its caller still has it.
#[derive(Debug)]
pub(super) struct Part {
    file: File,
    path: PathBuf,
    /// Bytes in the file.
    pub(super) size: u64,
    /// Bytes known to be on disk.
    pub(super) synced: u64,
    claim: Claim,
}

impl Part {
    /// Opens the part file at `path` to append after `committed`. Bytes beyond were never acknowledged and are cut.
    pub(super) async fn open(path: PathBuf, committed: u64, claim: Claim) -> Result<Self> {
        off_runtime("opening a part file", move || {
            let file = open_at(&path, committed).map_err(|error| refused("opening", &path, error))?;
            Ok(Self { file, path, size: committed, synced: committed, claim })
        })
        .await
    }

    /// Completes when another client claims this upload.
    pub(super) async fn leave(&self) {
        self.claim.leave.cancelled().await;
    }

    /// Appends bytes. They may be lost until [`Part::sync`].
    pub(super) async fn append(mut self, data: Bytes) -> Result<Self> {
        off_runtime("writing a part file", move || {
            self.file.write_all(&data).map_err(|error| refused("writing", &self.path, error))?;
            crate::fail_point::pass("upload.bytes_written");
            self.size = self.size.saturating_add(data.len() as u64);
            self.claim.alive();
            Ok(self)
        })
        .await
    }

    /// Syncs every byte. After an error those since the last sync are in doubt: [`Part::open`] cuts them.
    pub(super) async fn sync(mut self) -> Result<Self> {
        off_runtime("syncing a part file", move || {
            self.file.sync_data().map_err(|error| refused("syncing", &self.path, error))?;
            crate::fail_point::pass("upload.bytes_synced");
            self.synced = self.size;
            Ok(self)
        })
        .await
    }
}

fn open_at(path: &Path, committed: u64) -> io::Result<File> {
    let mut file = File::options().write(true).open(path)?;
    let size = file.metadata()?.len();
    if size < committed {
        return Err(io::Error::other(format!("it has {size} bytes, but {committed} were acknowledged")));
    }
    if size > committed {
        drop(file);
        cut(path, committed)?;
        file = File::options().write(true).open(path)?;
    }
    file.seek(SeekFrom::Start(committed))?;
    Ok(file)
}

/// Cuts bytes beyond `committed`, and syncs. A part that has another name is also a recording of this server's own,
/// which must stay whole: the part then becomes a file of its own.
pub(super) fn cut(path: &Path, committed: u64) -> io::Result<()> {
    let file = File::options().read(true).write(true).open(path)?;
    if file.metadata()?.nlink() == 1 {
        file.set_len(committed)?;
        return file.sync_all();
    }
    let draft = path.with_extension("draft");
    let mut own = File::create(&draft)?;
    io::copy(&mut file.take(committed), &mut own)?;
    own.sync_all()?;
    std::fs::rename(&draft, path)
}

/// Creates an empty part file and syncs its name.
pub(super) fn create(path: &Path) -> Result<()> {
    File::create_new(path).and_then(|file| file.sync_all()).map_err(|error| refused("making", path, error))?;
    path.parent().map_or(Ok(()), sync_folder)
}

pub(super) fn refused(doing: &str, path: &Path, error: io::Error) -> Error {
    if matches!(error.kind(), io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded) {
        return Error::exhausted(
            "the server's disk is full; free some space on the disk of its data folder (--data-dir) and resume the \
             upload",
        );
    }
    if error.kind() == io::ErrorKind::FileTooLarge {
        return Error::exhausted(
            "the recording has reached the largest file that the server's process or file system allows: raise the \
             limit there (`ulimit -f`, LimitFSIZE= of its service), then push the file again; the upload resumes",
        );
    }
    Error::internal(format!("{doing} {}", path.display()), error)
}
