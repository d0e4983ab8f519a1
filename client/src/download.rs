//! Downloads: a stream of bytes into a file, which appears under its name only when it is whole and verified.

use std::os::unix::fs::PermissionsExt as _;
use std::path::{Component, Path};

use bytes::Bytes;
use futures::{Stream, StreamExt as _};
use gleaner_proto::v1::{DownloadEpisodeRequest, Episode, GetEpisodeRequest};
use tokio::io::AsyncWriteExt as _;

use crate::connection::Client;
use crate::direct::Direct;
use crate::error::{ClientError, Result};

impl Client {
    /// Downloads an episode's recording, as it was uploaded, and checks its digest.
    ///
    /// # Errors
    /// [`ClientError::Rejected`] when there is no such episode, [`ClientError::Damaged`] when other bytes
    /// arrive than were uploaded, [`ClientError::Io`] when the file can't be written.
    pub async fn download_episode(&self, episode_id: &str, path: &Path, progress: impl Fn(u64)) -> Result<Episode> {
        let mut service = self.episodes();
        let request = GetEpisodeRequest { episode_id: episode_id.to_owned() };
        let episode = service.get_episode(request).await?.into_inner().episode;
        let episode = episode.ok_or(ClientError::Contract { missing: "an episode" })?;
        let open = async |accept_url| {
            let request = DownloadEpisodeRequest { episode_id: episode_id.to_owned(), accept_url };
            let pieces = self.episodes().download_episode(request).await?.into_inner();
            Ok(pieces.map(|piece| piece.map(|piece| Piece { data: piece.data, url: piece.url })))
        };
        let expected = Expected { blake3: &episode.blake3, size_bytes: episode.size_bytes };
        download(self.direct(), open, path, &expected, progress).await?;
        Ok(episode)
    }
}

/// What a file must be.
pub(crate) struct Expected<'a> {
    pub(crate) blake3: &'a str,
    /// More bytes than these are not read.
    pub(crate) size_bytes: u64,
}

/// Saves what `open` begins to download, given whether a URL is accepted: from the bucket where the server gives a URL
/// and the bucket can be reached, or else from the server.
pub(crate) async fn download<S>(
    direct: &Direct,
    open: impl AsyncFn(bool) -> Result<S>,
    path: &Path,
    expected: &Expected<'_>,
    progress: impl Fn(u64),
) -> Result<()>
where
    S: Stream<Item = std::result::Result<Piece, tonic::Status>> + Unpin,
{
    let mut pieces = open(direct.is_open()).await?;
    let first = pieces.next().await.transpose()?;
    if let Some(Piece { url, .. }) = first.as_ref().filter(|first| !first.url.is_empty()) {
        match save_from_bucket(direct, url, path, expected, &progress).await {
            Ok(()) => return Ok(()),
            Err(error @ ClientError::Io { .. }) => return Err(error),
            Err(_) => direct.close(),
        }
        pieces = open(false).await?;
        return save(pieces.map(|piece| Ok(piece?.data)), path, expected, progress).await;
    }
    let all = futures::stream::iter(first.map(Ok)).chain(pieces);
    save(all.map(|piece| Ok(piece?.data)), path, expected, progress).await
}

async fn save_from_bucket(
    direct: &Direct,
    url: &str,
    path: &Path,
    expected: &Expected<'_>,
    progress: impl Fn(u64),
) -> Result<()> {
    let bytes = direct.get(url).await?;
    save(std::pin::pin!(bytes), path, expected, progress).await
}

/// A message of a download: the next bytes, or the URL of all of them.
pub(crate) struct Piece {
    pub(crate) data: Bytes,
    pub(crate) url: String,
}

/// A name that stays inside the folder it is joined to.
pub(crate) fn relative(name: &str) -> Result<&Path> {
    let path = Path::new(name);
    let stays = path.components().all(|part| matches!(part, Component::Normal(_)));
    if stays && !name.is_empty() {
        return Ok(path);
    }
    Err(ClientError::Invalid(format!(
        "the export contains a file named {name:?}, which is outside the folder; it was not written"
    )))
}

/// Writes a stream of bytes to a file, which appears under its name once it is whole and has the expected digest.
pub(crate) async fn save(
    mut pieces: impl Stream<Item = Result<Bytes>> + Unpin,
    path: &Path,
    expected: &Expected<'_>,
    progress: impl Fn(u64),
) -> Result<()> {
    let folder = match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        Some(_) | None => Path::new("."),
    };
    std::fs::create_dir_all(folder).map_err(ClientError::io(folder))?;
    // Deleted on drop after a failure. Readable as any new file is, not only by its owner.
    let part = tempfile::Builder::new()
        .prefix(".gleaner-")
        .permissions(std::fs::Permissions::from_mode(0o666))
        .tempfile_in(folder)
        .map_err(ClientError::io(folder))?;
    let mut file = tokio::fs::File::create(part.path()).await.map_err(ClientError::io(path))?;
    let mut hasher = blake3::Hasher::new();
    while let Some(piece) = pieces.next().await {
        let piece = piece?;
        hasher.update(&piece);
        if hasher.count() > expected.size_bytes {
            break;
        }
        file.write_all(&piece).await.map_err(ClientError::io(path))?;
        progress(hasher.count());
    }
    sync(&mut file).await.map_err(ClientError::io(path))?;
    let found = hasher.finalize().to_hex().to_string();
    if found != expected.blake3 {
        let what = path.display().to_string();
        return Err(ClientError::Damaged { what, expected: expected.blake3.to_owned(), found });
    }
    part.persist(path).map_err(|error| ClientError::Io { path: path.to_owned(), source: error.error })?;
    Ok(())
}

/// Writes what is buffered, and waits until the disk has it.
async fn sync(file: &mut tokio::fs::File) -> std::io::Result<()> {
    // `sync_all` returns no error of the last write, which is still under way: on a full disk the end would be missing.
    file.flush().await?;
    file.sync_all().await
}

#[cfg(test)]
mod tests;
