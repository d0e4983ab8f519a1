//! BLAKE3 digests of files.

use std::path::Path;

use crate::error::{ClientError, Result};
use crate::file::{off_runtime, open_regular};

/// A file's size and digest.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Digest {
    pub(crate) size_bytes: u64,
    /// Lower-case hex.
    pub(crate) blake3: String,
}

/// Reads a file through once, off the runtime's own threads.
pub(crate) async fn digest_file(path: &Path) -> Result<Digest> {
    let owned = path.to_owned();
    let digest = move || {
        let mut hasher = blake3::Hasher::new();
        hasher.update_reader(open_regular(&owned)?).map_err(ClientError::io(&owned))?;
        Ok(Digest { size_bytes: hasher.count(), blake3: hasher.finalize().to_hex().to_string() })
    };
    off_runtime(path, digest).await
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn digests_are_those_of_the_blake3_paper() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("empty");
        std::fs::write(&file, b"").unwrap();
        let digest = digest_file(&file).await.unwrap();
        assert_eq!(digest.size_bytes, 0);
        assert_eq!(digest.blake3, "af1349b9f5f9a1a6a0404dea36dcc9499bcb25c9adc112b7cc9a93cae41f3262");
    }

    #[tokio::test]
    async fn a_missing_file_is_named() {
        let error = digest_file(Path::new("no/such/file.mcap")).await.unwrap_err();
        assert!(error.to_string().contains("no/such/file.mcap"));
    }
}
