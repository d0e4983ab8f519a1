//! Moves a file to its place, also from another disk: an operator may have moved the blobs to a larger one.

use std::{
    fs::{self, File},
    io,
    os::unix::fs::MetadataExt as _,
    path::Path,
    time::{Duration, SystemTime},
};

use tempfile::{NamedTempFile, TempPath};

/// The prefix of drafts' names.
const DRAFT: &str = ".draft-";

/// Renames `from` to `to`. Between two disks the content is copied beside `to`, synced and renamed, and `from` removed:
/// `to` is complete or missing.
///
/// # Errors
/// The error of the disk; then `from` still exists.
pub fn rename(from: &Path, to: &Path) -> io::Result<()> {
    match fs::rename(from, to) {
        Err(error) if error.kind() == io::ErrorKind::CrossesDevices => {
            let mut draft = draft(to.parent().unwrap_or(Path::new(".")))?;
            io::copy(&mut File::open(from)?, draft.as_file_mut())?;
            draft.as_file().set_modified(fs::metadata(from)?.modified()?)?;
            draft.as_file().sync_all()?;
            draft.persist(to).map_err(|error| error.error)?;
            fs::remove_file(from)
        }
        renamed => renamed,
    }
}

/// A draft file, to be written and then renamed in its folder.
///
/// # Errors
/// The error of the disk.
pub(super) fn draft(folder: &Path) -> io::Result<NamedTempFile> {
    tempfile::Builder::new().prefix(DRAFT).tempfile_in(folder)
}

/// A second name of a file, in the same folder; it is removed on drop, and by the sweep of drafts after a crash.
///
/// # Errors
/// The error of the disk.
pub(super) fn link(path: &Path) -> io::Result<TempPath> {
    let folder = path.parent().unwrap_or(Path::new("."));
    let linked = tempfile::Builder::new().prefix(DRAFT).make_in(folder, |link| fs::hard_link(path, link))?;
    Ok(linked.into_temp_path())
}

/// Whether a draft was made and last written before `time`; not if it is gone. A second name has the content's old time of
/// writing, and the system notes when it got the name.
///
/// # Errors
/// The error of the disk.
pub(super) fn is_older(draft: &Path, time: SystemTime) -> io::Result<bool> {
    let file = match fs::symlink_metadata(draft) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(false),
        file => file?,
    };
    let changed = u64::try_from(file.ctime())
        .map_or(SystemTime::UNIX_EPOCH, |seconds| SystemTime::UNIX_EPOCH + Duration::from_secs(seconds));
    Ok(file.modified()?.max(changed) < time)
}

/// Whether a file is a draft, perhaps of a killed process.
pub(super) fn is_draft(path: &Path) -> bool {
    path.file_name().is_some_and(|name| name.as_encoded_bytes().starts_with(DRAFT.as_bytes()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_second_name_is_as_old_as_its_making() {
        let folder = tempfile::tempdir().unwrap();
        let (path, day) = (folder.path().join("blob"), Duration::from_secs(24 * 60 * 60));
        fs::write(&path, b"steps").unwrap();
        File::open(&path).unwrap().set_modified(SystemTime::UNIX_EPOCH).unwrap();
        let name = link(&path).unwrap();
        assert!(!is_older(&name, SystemTime::now() - day).unwrap(), "it is in use");
        assert!(is_older(&name, SystemTime::now() + day).unwrap());
        assert!(!is_older(&folder.path().join("gone"), SystemTime::now() + day).unwrap());
    }

    /// Memory and disk are two file systems on most machines; on one file system, this is a plain rename.
    #[test]
    fn a_file_of_another_disk_arrives_whole() {
        let here = tempfile::tempdir().unwrap();
        let there = tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).unwrap();
        let (from, to) = (there.path().join("part"), here.path().join("blob"));
        fs::write(&from, b"steps").unwrap();
        rename(&from, &to).unwrap();
        assert_eq!(fs::read(&to).unwrap(), b"steps");
        assert!(!from.exists());
        assert_eq!(fs::read_dir(here.path()).unwrap().count(), 1);
        assert!(rename(&from, &to).is_err(), "the source is missing");
        assert_eq!(fs::read(&to).unwrap(), b"steps");
    }
}
