//! Permissions of a data folder: only its owner may read it. New files get them from the process's umask; wider ones
//! are reported.

use std::{
    fs,
    os::unix::fs::{DirBuilderExt as _, MetadataExt as _},
    path::Path,
};

use rustix::{fs::Mode, process::umask};

use crate::{BLOBS, DATABASE};
use gleaner_core::error::{Error, Result};

/// Permission bits of the group and of all others.
const OTHERS: u32 = 0o077;
/// The bit of folders in which each user removes their own files only.
const STICKY: u32 = 0o1000;

/// Restricts every file and folder that this process and its children create from now on to its owner (0600 and 0700).
pub fn keep_private() {
    umask(Mode::from_raw_mode(OTHERS));
}

/// Makes a folder that only its owner may enter, and its missing parents.
///
/// # Errors
/// The error of the system.
pub fn make_private_folder(folder: &Path) -> std::io::Result<()> {
    fs::DirBuilder::new().recursive(true).mode(0o700).create(folder)
}

/// Rejects a folder for drafts that a link leads to a folder of many programs, such as `/tmp`: each start and each sweep
/// remove the files in it.
///
/// # Errors
/// Precondition names the folder; Internal when it cannot be read.
pub(crate) fn expect_unshared(folder: &Path) -> Result<()> {
    let fault = |error| Error::internal(format!("reading {}", folder.display()), error);
    if fs::symlink_metadata(folder).map_err(fault)?.is_symlink()
        && fs::metadata(folder).map_err(fault)?.mode() & STICKY != 0
    {
        return Err(Error::precondition(format!(
            "{} leads to a folder that other programs use too, and the server removes every file in it: make it lead to a \
             folder of its own",
            folder.display()
        )));
    }
    Ok(())
}

/// Logs a warning for each of the data folder, its database and its blobs that the group or others may read or write. A
/// data folder that only its owner may enter protects its contents.
pub fn warn_if_open(data_dir: &Path) {
    for wider in wider_than_owner(data_dir) {
        tracing::warn!("{wider}");
    }
}

/// A sentence for each path that is open to more than its owner.
fn wider_than_owner(data_dir: &Path) -> Vec<String> {
    let mode = |path: &Path| fs::metadata(path).ok().map(|file| file.mode() & 0o777);
    if mode(data_dir).is_none_or(|mode| mode & OTHERS == 0) {
        return Vec::new();
    }
    let inside = [data_dir.to_owned(), data_dir.join(DATABASE), data_dir.join(BLOBS)];
    let wide = inside.iter().filter_map(|path| Some((path, mode(path)?))).filter(|(_, mode)| mode & OTHERS != 0);
    wide.map(|(path, mode)| {
        let shown = path.display();
        format!(
            "{shown} has mode {mode:04o}: other users of this machine can read it. Close it with `chmod -R go-rwx {}`",
            data_dir.display()
        )
    })
    .collect()
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt as _;

    use super::*;

    #[test]
    fn only_paths_open_to_others_are_reported() {
        let dir = tempfile::tempdir().unwrap();
        let lab = dir.path().join("lab");
        make_private_folder(&lab).unwrap();
        assert_eq!(fs::metadata(&lab).unwrap().mode() & 0o777, 0o700);
        let database = lab.join(DATABASE);
        fs::write(&database, b"").unwrap();
        fs::set_permissions(&database, fs::Permissions::from_mode(0o644)).unwrap();
        assert!(wider_than_owner(&lab).is_empty(), "the folder itself is closed");
        fs::set_permissions(&lab, fs::Permissions::from_mode(0o750)).unwrap();
        let wide = wider_than_owner(&lab);
        assert_eq!(wide.len(), 2, "{wide:?}");
        assert!(wide[0].contains("0750") && wide[0].contains("chmod -R go-rwx"), "{wide:?}");
        assert!(wide[1].contains("gleaner.db has mode 0644"), "{wide:?}");
    }

    #[test]
    fn drafts_are_not_in_a_folder_of_many_programs() {
        let dir = tempfile::tempdir().unwrap();
        let [lab, other] = ["lab", "other"].map(|name| dir.path().join(name));
        fs::create_dir_all(&lab).unwrap();
        fs::create_dir_all(&other).unwrap();
        std::os::unix::fs::symlink(&other, lab.join("tmp")).unwrap();
        crate::blobs::Blobs::open(&lab).unwrap();
        fs::set_permissions(&other, fs::Permissions::from_mode(0o1777)).unwrap();
        let error = crate::blobs::Blobs::open(&lab).unwrap_err();
        assert!(error.message().contains("lab/tmp leads to a folder that other programs use"), "{error}");
    }
}
