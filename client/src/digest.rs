//! BLAKE3 digests of files.

use std::path::Path;

use crate::error::{ClientError, Result};
use crate::file::open_regular;

/// A file's size and digest.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Digest {
    pub(crate) size_bytes: u64,
    /// Lower-case hex.
    pub(crate) blake3: String,
}

impl Digest {
    /// Reads a file through once.
    pub(crate) fn of(path: &Path) -> Result<Self> {
        let mut hasher = blake3::Hasher::new();
        hasher.update_reader(open_regular(path)?).map_err(ClientError::io(path))?;
        Ok(Self { size_bytes: hasher.count(), blake3: hasher.finalize().to_hex().to_string() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn digests_are_those_of_the_blake3_paper() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("empty");
        std::fs::write(&file, b"").unwrap();
        let digest = Digest::of(&file).unwrap();
        assert_eq!(digest.size_bytes, 0);
        assert_eq!(digest.blake3, "af1349b9f5f9a1a6a0404dea36dcc9499bcb25c9adc112b7cc9a93cae41f3262");
    }

    #[test]
    fn a_missing_file_is_named() {
        let error = Digest::of(Path::new("no/such/file.mcap")).unwrap_err();
        assert!(error.to_string().contains("no/such/file.mcap"));
    }
}
