//! Files to send: regular ones only, and under a name that can be shown.
//!
//! Opening a FIFO waits for a writer that may never come, and opening a device can have effects; so the kind is looked
//! at before and after a file is opened.

use std::fs::{File, FileType};
use std::os::unix::fs::FileTypeExt as _;
use std::path::{Path, PathBuf};

use gleaner_recording::printable;
use rustix::fs::{Mode, OFlags};

use crate::error::{ClientError, Result};

/// Longest file name that the server takes, in bytes.
const LONGEST_NAME: usize = 255;

/// Opens a regular file for reading, or what a link leads to if that is one.
///
/// # Errors
/// [`ClientError::Io`] when it can't be read; [`ClientError::Invalid`] when it is something else, with its kind.
pub(crate) fn open_regular(path: &Path) -> Result<File> {
    let regular = |kind: FileType| if kind.is_file() { Ok(()) } else { Err(irregular(path, kind)) };
    regular(std::fs::metadata(path).map_err(ClientError::io(path))?.file_type())?;
    // It may have been replaced since; without waiting, even a FIFO opens at once.
    let opened = rustix::fs::open(path, OFlags::RDONLY | OFlags::NONBLOCK | OFlags::CLOEXEC, Mode::empty());
    let file = File::from(opened.map_err(|errno| ClientError::io(path)(errno.into()))?);
    regular(file.metadata().map_err(ClientError::io(path))?.file_type())?;
    Ok(file)
}

/// The error for what is not a regular file.
pub(crate) fn irregular(path: &Path, kind: FileType) -> ClientError {
    ClientError::Invalid(format!("{}: {}; only regular files can be sent", path.display(), describe(kind)))
}

/// What something is that is not a regular file.
pub(crate) fn describe(kind: FileType) -> &'static str {
    if kind.is_dir() {
        "is a folder"
    } else if kind.is_fifo() {
        "is a FIFO"
    } else if kind.is_socket() {
        "is a socket"
    } else if kind.is_block_device() || kind.is_char_device() {
        "is a device"
    } else {
        "is not a regular file"
    }
}

/// The name that a recording is sent under: the file's own, with unprintable characters escaped, because the server
/// refuses control characters in names.
pub(crate) fn name_to_send(path: &Path) -> String {
    let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let mut name = printable::field(&name).into_owned();
    name.truncate(name.floor_char_boundary(LONGEST_NAME));
    name
}

/// Runs blocking work on a file off the runtime's own threads.
pub(crate) async fn off_runtime<T: Send + 'static>(
    path: PathBuf,
    work: impl FnOnce() -> Result<T> + Send + 'static,
) -> Result<T> {
    match tokio::task::spawn_blocking(work).await {
        Ok(done) => done,
        Err(failed) => Err(ClientError::Io { path, source: std::io::Error::other(failed) }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_sent_escaped_and_within_the_servers_limit() {
        assert_eq!(name_to_send(Path::new("lab/pick 抓取.mcap")), "pick 抓取.mcap");
        assert_eq!(name_to_send(Path::new("lab/\u{1b}[2J\u{202e}.mcap")), "\\u{1b}[2J\\u{202e}.mcap");
        let long = name_to_send(Path::new(&"\u{1b}é".repeat(85)));
        assert!(long.len() <= LONGEST_NAME && !long.contains('\u{1b}'), "{long}");
    }

    #[test]
    fn regular_files_open_and_others_are_refused_with_their_kind() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::write(at("file"), b"x").unwrap();
        std::os::unix::fs::symlink(at("file"), at("link")).unwrap();
        std::os::unix::fs::symlink("nowhere", at("dangling")).unwrap();
        rustix::fs::mknodat(rustix::fs::CWD, at("fifo"), rustix::fs::FileType::Fifo, 0o600.into(), 0).unwrap();
        let _socket = std::os::unix::net::UnixListener::bind(at("socket")).unwrap();
        assert!(open_regular(&at("file")).is_ok() && open_regular(&at("link")).is_ok());
        for (path, part) in [
            (at("fifo"), "is a FIFO"),
            (at("socket"), "is a socket"),
            ("/dev/null".into(), "is a device"),
            (folder.path().to_owned(), "is a folder"),
            (at("dangling"), "No such file"),
        ] {
            let error = open_regular(&path).unwrap_err().to_string();
            assert!(error.contains(part) && error.contains(path.to_str().unwrap()), "{error}");
        }
    }
}
