//! Blobs of a process that has no credentials of their bucket, such as a worker. It reads objects at URLs that the server
//! signs; if it signs no URL, it fetches the copy, and it alone puts blobs into the bucket. Both ends are here, and the
//! calls between them in `calls`.

use std::{
    fs, io,
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use gleaner_bucket::Part;
use gleaner_core::{
    error::{Error, Kind, Result},
    id::BlobId,
};
use tempfile::NamedTempFile;

use super::{
    Blobs,
    calls::{ByServer, Located, Want},
    copies, digest, fault, names,
    remote::Remote,
};

/// The URLs that are tried for one copy before the server fetches it.
const URLS: usize = 2;
/// The attempts to hand over a file that another process hands over too.
const ATTEMPTS: usize = 5;
/// The time for a copy of the server to become visible here, for each of the attempts to open it. A network file system
/// shows the absence of a file for up to a minute after another machine has made it.
const VISIBLE_AFTER: Duration = Duration::from_secs(15);
/// The interval between looks at such a folder.
const LOOK: Duration = Duration::from_millis(100);

/// The process without credentials.
impl Blobs {
    /// Fetches the copy of a blob: at a URL, at another one if that fails, and then by the server.
    pub(super) fn fetch_by(&self, server: &ByServer, id: &BlobId, path: &Path) -> Result<()> {
        let mut begun: Option<(NamedTempFile, Part)> = None;
        for turn in 0..=URLS {
            let want = Want::Content { accept_url: turn < URLS && server.urls.is_open() };
            let found = server.calls.locate(id, want)?;
            let missing = || Error::damaged(format!("the object {} is missing (--blob-store)", self.name(id)));
            let Located { size_bytes, url } = found.ok_or_else(missing)?;
            let Some(url) = url else {
                let shared = self.path(id);
                wait_for(&shared);
                return if shared == path { Ok(()) } else { self.copy_to_node(id, &shared, path) };
            };
            let (draft, part) = match begun.take() {
                Some(begun) => begun,
                None => self.begin(size_bytes, path)?,
            };
            match server.urls.read(&url, part)? {
                (part, Ok(())) if part.digest() == *id => return copies::keep(draft, path),
                (_, Ok(())) => {
                    tracing::warn!(blob.id = %id, "the content at a signed URL does not have the digest of its blob");
                }
                (part, Err(error)) => {
                    tracing::warn!(blob.id = %id, %error, "a blob could not be read at its signed URL");
                    if turn + 1 == URLS {
                        server.urls.close();
                    }
                    begun = Some((draft, part));
                }
            }
        }
        Err(Error::internal(format!("reading {}", self.name(id)), "the server returned a URL in place of a copy"))
    }

    fn begin(&self, size: u64, path: &Path) -> Result<(NamedTempFile, Part)> {
        self.make_copy_room_here(size)?;
        let draft = self.draft_of(path)?;
        let to = draft.as_file().try_clone().map_err(fault("opening", path))?;
        Ok((draft, Part::new(to, size)))
    }

    /// Has the server store a complete and synced file as a blob; `from` no longer exists afterwards.
    pub(super) fn hand_over(&self, server: &ByServer, id: &BlobId, from: &Path) -> Result<()> {
        let handed = self.handed(id);
        for _ in 0..ATTEMPTS {
            match fs::hard_link(from, &handed) {
                // Another process hands over the same content.
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
                linked => linked.map_err(fault("linking", &handed))?,
            }
            let stored = server.calls.store(id);
            // Of a failure. After a success it has moved to its place.
            remove(&handed)?;
            match stored {
                // The other process has removed it.
                Err(error) if error.kind() == Kind::NotFound => {}
                stored => return stored.and_then(|()| remove(from)),
            }
        }
        Err(Error::unavailable(format!("{}: other processes removed it each time; retry", handed.display())))
    }

    /// Where a process hands over the content of a blob: a name that only the digest determines.
    fn handed(&self, id: &BlobId) -> PathBuf {
        self.unfinished.join(format!("handed-{id}"))
    }
}

/// The server.
impl Blobs {
    /// Makes room below the limit of copies for that of a blob, and returns its size; `None` when it is missing.
    ///
    /// # Errors
    /// As for [`Blobs::size`].
    pub fn make_copy_room(&self, id: &BlobId) -> Result<Option<u64>> {
        let size = self.size(id)?;
        if let (Some(size), Some(Remote::Bucket(own))) = (size, self.remote.as_deref()) {
            self.limit_copies(own, size)?;
        }
        Ok(size)
    }

    /// Has a sound copy of a blob in the folder: a damaged one is fetched again. Without a bucket, the blob is there.
    ///
    /// # Errors
    /// As for [`Blobs::fetched`].
    pub fn keep_copy(&self, id: &BlobId) -> Result<()> {
        let (Some(remote), path) = (&self.remote, self.path(id)) else { return Ok(()) };
        // Another process may have fetched it.
        if path.exists() && digest(&path).ok().as_ref() == Some(id) {
            return Ok(());
        }
        self.fetch(remote, id, &path)
    }

    /// Stores the file that a process has handed over as this blob. A blob that exists already needs no file, because a call
    /// may be repeated.
    ///
    /// # Errors
    /// NotFound when there is neither; Precondition when the content is another one; as for [`Blobs::place`].
    pub fn take(&self, id: &BlobId) -> Result<()> {
        let handed = self.handed(id);
        let file = match fs::symlink_metadata(&handed) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return self.expect_stored(id),
            file => file.map_err(fault("reading", &handed))?,
        };
        let wrong = |what: &str| Error::precondition(format!("{}: {what}; write it again", handed.display()));
        if !file.is_file() {
            return Err(wrong("is not a file"));
        }
        match digest(&handed) {
            Ok(found) if found == *id => {}
            Ok(_) => return Err(wrong("does not have the digest of its name")),
            Err(error) => return self.expect_stored(id).map_err(|_| error),
        }
        // A repeated call may have placed it meanwhile.
        self.place(id, &handed).or_else(|error| match handed.exists() {
            true => Err(error),
            false => self.expect_stored(id).map_err(|_| error),
        })
    }

    fn expect_stored(&self, id: &BlobId) -> Result<()> {
        self.size(id)?.map(drop).ok_or_else(|| Error::not_found("blob", id))
    }
}

/// Waits for a copy that the server has made, at most [`VISIBLE_AFTER`]: it may also have been removed for others' sake, and
/// the caller then fetches it again.
fn wait_for(path: &Path) {
    let begun = Instant::now();
    while !path.exists() && begun.elapsed() < VISIBLE_AFTER {
        // A network file system reads the folder again for this.
        if path.parent().is_some_and(|folder| names(folder).is_ok()) && path.exists() {
            return;
        }
        std::thread::park_timeout(LOOK);
    }
}

fn remove(path: &Path) -> Result<()> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(fault("removing", path)(error)),
        Ok(()) | Err(_) => Ok(()),
    }
}

#[cfg(test)]
mod tests;
