//! Files that appear under their name only once they are complete.

use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use crate::error::RecordingError;

/// Distinguishes the partial files of one process.
static NEXT_PARTIAL: AtomicU64 = AtomicU64::new(0);

/// Writes a file beside its name, syncs it and renames it; after an error no file is left.
///
/// # Errors
/// The errors of `write`, and [`RecordingError::Io`].
pub(crate) fn write_whole(
    path: &Path,
    write: impl FnOnce(BufWriter<File>) -> Result<BufWriter<File>, RecordingError>,
) -> Result<(), RecordingError> {
    let io = |source| RecordingError::Io { path: path.to_path_buf(), source };
    let partial = beside(path);
    let written = File::create(&partial).map_err(io).and_then(|file| {
        let file = write(BufWriter::new(file))?.into_inner().map_err(|error| io(error.into_error()))?;
        file.sync_all().map_err(io)?;
        std::fs::rename(&partial, path).map_err(io)
    });
    if written.is_err() {
        // The first error is returned; an error of this removal is not.
        let _ = std::fs::remove_file(&partial);
    }
    written
}

/// A name in the same folder that no other process or thread uses.
fn beside(path: &Path) -> PathBuf {
    let mut name = path.file_name().unwrap_or_default().to_owned();
    let number = NEXT_PARTIAL.fetch_add(1, Ordering::Relaxed);
    name.push(format!(".{}-{number}.partial", std::process::id()));
    path.with_file_name(name)
}

#[cfg(test)]
mod tests {

    use std::io::Write;

    use super::*;

    #[test]
    fn failed_write_leaves_the_old_file_only() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        std::fs::write(&path, "old").unwrap();
        let failed = write_whole(&path, |mut out| {
            out.write_all(b"half").unwrap();
            Err(RecordingError::Cache { problem: "test".into() })
        });
        assert!(failed.is_err());
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
        assert!(write_whole(&folder.path().join("no/such/folder"), Ok).is_err());
    }
}
