//! Sends files to the bucket and fetches them, in pieces of which several are under way at once.

use std::{
    collections::VecDeque,
    fs::File,
    io::{Read as _, Write},
    path::Path,
    sync::Arc,
};

use bytes::Bytes;
use futures::TryStreamExt as _;
use gleaner_core::{
    error::{Error, Result},
    id::BlobId,
};
use object_store::{ObjectStore, ObjectStoreExt as _, PutPayload, WriteMultipart, path::Path as Key};

use super::{Bucket, wait::wait};

/// The largest file that is stored by one request, and the piece of an object that is read by one.
pub(crate) const ONE_REQUEST_BYTES: usize = 16 << 20;
/// The smallest piece of a larger file. All that are under way share the rate of the store and are each sent within the
/// timeout: by default, from 0.6 MB/s.
const PIECE_BYTES: usize = 8 << 20;
/// The most pieces of one object that S3 takes, each of at least 5 MiB.
const PIECES: u64 = 10_000;
/// Pieces of one file under way at once; each is in memory.
const AT_ONCE: usize = 4;
/// The largest file that is read by one request. More requests at once are faster from a distant store, and slower from a
/// near one.
const STREAMED_BYTES: u64 = 64 << 20;
/// The largest object that S3 copies in one request.
const LARGEST_COPY: u64 = 5 << 30;

/// The failure of a transfer: of the store, or of a disk.
enum Failure {
    Store(object_store::Error),
    Disk(std::io::Error),
    Short,
}

impl From<object_store::Error> for Failure {
    fn from(error: object_store::Error) -> Self {
        Self::Store(error)
    }
}

impl From<std::io::Error> for Failure {
    fn from(error: std::io::Error) -> Self {
        Self::Disk(error)
    }
}

impl Bucket {
    /// Stores a file under a name, replacing an earlier one. It is in the store once this returns.
    ///
    /// # Errors
    /// Unavailable when the store fails; Internal when the file cannot be read.
    pub fn put(&self, name: &str, from: &Path) -> Result<()> {
        let (store, key, path) = (Arc::clone(&self.store), self.key(name), from.to_owned());
        wait(send(store, key, path))?.map_err(|failure| self.failed("storing", name, failure))
    }

    /// Writes a file with this digest to `to` and returns its size. Nothing reads `to` unless this succeeds.
    ///
    /// # Errors
    /// Damaged when the object is missing, or is altered or truncated; Unavailable when the store fails; Exhausted when
    /// the disk is full.
    pub fn fetch(&self, name: &str, digest: &BlobId, to: &File) -> Result<u64> {
        let to = to.try_clone().map_err(|error| Error::internal(format!("writing {name}"), error))?;
        let (found, size) = self.read(name, to)?;
        match found == *digest {
            true => Ok(size),
            false => Err(Error::damaged(format!(
                "the object {name} in {} (--blob-store) is damaged: its {size} bytes do not have the digest of its name",
                self.shown()
            ))),
        }
    }

    /// The digest of a stored file, whatever its name.
    ///
    /// # Errors
    /// As for [`Bucket::fetch`].
    pub fn digest(&self, name: &str) -> Result<BlobId> {
        Ok(self.read(name, std::io::sink())?.0)
    }

    /// Gives a file another name, and the present time. After a failure it has one of the two names, or both.
    ///
    /// # Errors
    /// Damaged when it is missing; Unavailable when the store fails.
    pub fn rename(&self, from: &str, to: &str) -> Result<()> {
        let (store, source, target) = (Arc::clone(&self.store), self.key(from), self.key(to));
        let copied = wait(async move {
            let size = store.head(&source).await?.size;
            if size <= LARGEST_COPY {
                store.copy(&source, &target).await
            } else {
                resend(&store, &source, &target, size).await
            }
        })?;
        copied.map_err(|error| self.fault("renaming", from, error))?;
        self.remove(from)
    }

    fn read(&self, name: &str, to: impl Write + Send + 'static) -> Result<(BlobId, u64)> {
        let (store, key) = (Arc::clone(&self.store), self.key(name));
        wait(receive(store, key, to))?.map_err(|failure| self.failed("reading", name, failure))
    }

    fn failed(&self, doing: &str, name: &str, failure: Failure) -> Error {
        match failure {
            Failure::Store(error) => self.fault(doing, name, error),
            Failure::Disk(error) => Error::internal(format!("{doing} {name}"), error),
            Failure::Short => Error::damaged(format!(
                "the object {name} in {} (--blob-store) is damaged: the store sent another number of bytes than it has by \
                 its size",
                self.shown()
            )),
        }
    }
}

async fn send(store: Arc<dyn ObjectStore>, key: Key, path: std::path::PathBuf) -> std::result::Result<(), Failure> {
    let mut file = File::open(path)?;
    let mut left = file.metadata()?.len();
    if left <= ONE_REQUEST_BYTES as u64 {
        store.put(&key, PutPayload::from_bytes(piece(&mut file, &mut left, ONE_REQUEST_BYTES)?)).await?;
        return Ok(());
    }
    let most = piece_bytes(left);
    let mut writing = WriteMultipart::new_with_chunk_size(store.put_multipart(&key).await?, most);
    while left > 0 {
        let next = piece(&mut file, &mut left, most);
        let ready = writing.wait_for_capacity(AT_ONCE).await;
        match next.map_err(Failure::from).and_then(|next| ready.map(|()| next).map_err(Failure::from)) {
            Ok(next) => writing.put(next),
            Err(failure) => {
                // The store keeps the pieces otherwise; if it cannot be asked, its life-cycle rule removes them.
                let _ = writing.abort().await;
                return Err(failure);
            }
        }
    }
    writing.finish().await?;
    Ok(())
}

/// The size of the pieces by which an object of `size` bytes is stored.
fn piece_bytes(size: u64) -> usize {
    usize::try_from(size.div_ceil(PIECES)).unwrap_or(usize::MAX).max(PIECE_BYTES)
}

/// The next piece of a file.
fn piece(file: &mut File, left: &mut u64, most: usize) -> std::io::Result<Bytes> {
    let length = usize::try_from(*left).unwrap_or(most).min(most);
    let mut piece = vec![0; length];
    file.read_exact(&mut piece)?;
    *left -= length as u64;
    Ok(piece.into())
}

async fn receive(
    store: Arc<dyn ObjectStore>,
    key: Key,
    mut to: impl Write + Send,
) -> std::result::Result<(BlobId, u64), Failure> {
    let size = store.head(&key).await?.size;
    let mut hasher = blake3::Hasher::new();
    if size <= STREAMED_BYTES {
        let (mut pieces, mut left) = (store.get(&key).await?.into_stream(), size);
        while let Some(piece) = pieces.try_next().await? {
            left = left.checked_sub(piece.len() as u64).ok_or(Failure::Short)?;
            hasher.update(&piece);
            to.write_all(&piece)?;
        }
        to.flush()?;
        return if left == 0 { Ok((hasher.finalize().into(), size)) } else { Err(Failure::Short) };
    }
    let (mut begun, mut coming) = (0, VecDeque::new());
    loop {
        while begun < size && coming.len() < AT_ONCE {
            let end = size.min(begun + ONE_REQUEST_BYTES as u64);
            let (store, key, range) = (Arc::clone(&store), key.clone(), begun..end);
            coming.push_back((end - begun, tokio::spawn(async move { store.get_range(&key, range).await })));
            begun = end;
        }
        let Some((length, next)) = coming.pop_front() else { break };
        let next = next.await.map_err(object_store::Error::from)??;
        if next.len() as u64 != length {
            return Err(Failure::Short);
        }
        hasher.update(&next);
        to.write_all(&next)?;
    }
    to.flush()?;
    Ok((hasher.finalize().into(), size))
}

/// Copies an object that is too large for one request of the store.
async fn resend(store: &Arc<dyn ObjectStore>, source: &Key, target: &Key, size: u64) -> object_store::Result<()> {
    let most = piece_bytes(size);
    let mut writing = WriteMultipart::new_with_chunk_size(store.put_multipart(target).await?, most);
    let mut begun = 0;
    while begun < size {
        let end = size.min(begun + most as u64);
        let ready = match store.get_range(source, begun..end).await {
            Ok(piece) => writing.wait_for_capacity(AT_ONCE).await.map(|()| piece),
            Err(error) => Err(error),
        };
        match ready {
            Ok(piece) => writing.put(piece),
            Err(error) => {
                // As in `send`.
                let _ = writing.abort().await;
                return Err(error);
            }
        }
        begun = end;
    }
    writing.finish().await.map(drop)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pieces_are_small_enough_for_a_slow_store_and_few_enough_for_s3() {
        for size in [17 << 20, 8 << 30, 78 << 30, 1 << 40, (5 << 40) - 1] {
            let piece = piece_bytes(size);
            assert!(
                size.div_ceil(piece as u64) <= PIECES && (size > 78 << 30 || piece == PIECE_BYTES),
                "{size}: {piece}"
            );
        }
    }
}
