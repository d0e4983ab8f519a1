//! Permissions of a data folder: only its owner may read it. New files get them from the process's umask; wider ones
//! are reported.

use std::{
    fs,
    os::unix::fs::{DirBuilderExt as _, MetadataExt as _},
    path::Path,
};

use rustix::{fs::Mode, process::umask};

use crate::{BLOBS, DATABASE};

/// Permission bits of the group and of all others.
const OTHERS: u32 = 0o077;

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
}
