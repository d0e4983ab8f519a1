//! A blob as a stream of pieces; one piece at a time is in memory.

use std::{path::PathBuf, time::Duration};

use bytes::{Bytes, BytesMut};
use futures::{Stream, StreamExt as _, TryStreamExt as _, stream::try_unfold};
use tokio::{fs::File, io::AsyncReadExt as _};

use super::{Blobs, digest, unreadable};
use gleaner_core::{
    Secret,
    error::{Error, Result},
    id::BlobId,
};

/// The size of a piece: well under the smallest message limit.
const PIECE_BYTES: usize = 1 << 20;

impl Blobs {
    /// The bytes of a blob in pieces of at most 1 MiB. The receiver checks the digest. The copy of a bucket's blob is checked
    /// here too, and removed at the end of the stream if it is damaged: the next reader fetches it again.
    ///
    /// # Errors
    /// Damaged when the blob is missing, and at the end of a damaged copy whose object is missing too; Internal when it
    /// cannot be read; Unavailable when the store fails, and at the end of another damaged copy.
    pub async fn stream(&self, id: &BlobId) -> Result<impl Stream<Item = Result<Bytes>> + Send + 'static> {
        if self.remote.is_none() {
            let path = self.path(id);
            let file = File::open(&path).await.map_err(|error| unreadable(id, &path, error))?;
            return Ok(pieces(file, path).left_stream());
        }
        let (blobs, wanted) = (self.clone(), id.clone());
        let fetching = tokio::task::spawn_blocking(move || blobs.fetched(&wanted));
        let fetched = fetching.await.map_err(|error| Error::internal("fetching a blob", error))??;
        // The open file needs no name.
        let pieces = stream_file(fetched.to_path_buf()).await?;
        Ok(checked(self.clone(), id.clone(), pieces).right_stream())
    }

    /// A URL of a blob in the bucket, whether or not it exists, for `lifetime`. `None` without a lifetime, where the folder
    /// holds the blobs, and without credentials to sign with.
    pub async fn signed_url(&self, id: &BlobId, lifetime: Option<Duration>) -> Option<Secret> {
        let (remote, lifetime, name) = (self.remote.clone()?, lifetime?, self.name(id));
        let signing = tokio::task::spawn_blocking(move || remote.own()?.bucket.signed_url(&name, lifetime));
        let signed = signing.await.map_err(|error| Error::internal("signing a URL", error)).flatten();
        signed.inspect_err(|error| tracing::warn!(%error, "no URL was signed; the server reads the blob")).ok()
    }
}

/// The pieces of a copy, and an error after them if they are not the blob's. Its copy is then removed.
fn checked(
    blobs: Blobs,
    id: BlobId,
    pieces: impl Stream<Item = Result<Bytes>> + Send + 'static,
) -> impl Stream<Item = Result<Bytes>> + Send + 'static {
    let begun = (pieces.boxed(), blake3::Hasher::new());
    try_unfold(begun, move |(mut pieces, mut hasher)| {
        let (blobs, id) = (blobs.clone(), id.clone());
        async move {
            if let Some(piece) = pieces.try_next().await? {
                hasher.update(&piece);
                return Ok(Some((piece, (pieces, hasher))));
            }
            if BlobId::from(hasher.finalize()) == id {
                return Ok(None);
            }
            let dropping = tokio::task::spawn_blocking(move || damage(&blobs, &id));
            Err(dropping.await.map_err(|error| Error::internal("removing a damaged copy", error))??)
        }
    })
}

/// The error of a damaged copy, which is removed if the bucket has the object.
fn damage(blobs: &Blobs, id: &BlobId) -> Result<Error> {
    let sound = || digest(&blobs.copy_path(id)).is_ok_and(|found| found == *id);
    if blobs.drop_damaged_copy(id)? || sound() {
        return Ok(Error::unavailable(format!(
            "the copy of {id} is damaged: its digest differs; retry, which fetches it again"
        )));
    }
    let name = blobs.name(id);
    Ok(Error::damaged(format!("the object {name} is missing (--blob-store), and its copy (--data-dir) is damaged")))
}

/// The bytes of any file in pieces, also after its name is removed.
///
/// # Errors
/// Internal when it cannot be read.
pub async fn stream_file(path: PathBuf) -> Result<impl Stream<Item = Result<Bytes>> + Send + 'static> {
    let fault = |error| Error::internal(format!("reading {}", path.display()), error);
    let file = File::open(&path).await.map_err(fault)?;
    Ok(pieces(file, path))
}

fn pieces(file: File, path: PathBuf) -> impl Stream<Item = Result<Bytes>> + Send + 'static {
    try_unfold((file, path), |(mut file, path)| async move {
        let mut piece = BytesMut::with_capacity(PIECE_BYTES);
        let fault = |error| Error::internal(format!("reading {}", path.display()), error);
        let read = (&mut file).take(PIECE_BYTES as u64).read_buf(&mut piece).await.map_err(fault)?;
        Ok((read > 0).then(|| (piece.freeze(), (file, path))))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn the_pieces_are_the_blob() {
        let dir = tempfile::tempdir().unwrap();
        let blobs = Blobs::open(dir.path()).unwrap();
        let content: Vec<u8> = (0..=250).cycle().take(PIECE_BYTES * 2 + 7).collect();
        let id = blobs.put(&content).unwrap();
        let pieces: Vec<Bytes> = blobs.stream(&id).await.unwrap().try_collect().await.unwrap();
        assert!(pieces.iter().all(|piece| piece.len() <= PIECE_BYTES));
        assert!(pieces.concat() == content);
    }

    #[tokio::test]
    async fn a_missing_blob_is_an_error_before_the_first_piece() {
        let dir = tempfile::tempdir().unwrap();
        let blobs = Blobs::open(dir.path()).unwrap();
        assert!(blobs.stream(&blake3::hash(b"x").into()).await.is_err());
    }
}
