//! `push --join`: which of the paths are one recording.

use std::path::PathBuf;

use crate::failure::{Failure, Result};

/// The recordings to join, with their parts if files are given: each folder is one, and all files are one.
pub(super) fn recordings(paths: &[PathBuf]) -> Result<Vec<(PathBuf, Vec<PathBuf>)>> {
    let (folders, files): (Vec<_>, Vec<_>) = paths.iter().cloned().partition(|path| path.is_dir());
    match (folders.is_empty(), files.first()) {
        (false, Some(file)) => Err(Failure::message(format!(
            "--join: {} is a file and {} a folder; give folders, or the parts of one recording",
            file.display(),
            folders[0].display()
        ))),
        (_, Some(first)) => Ok(vec![(first.clone(), files)]),
        (_, None) => Ok(folders.into_iter().map(|folder| (folder, Vec::new())).collect()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_folder_is_a_recording_and_all_files_are_one() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::create_dir(at("a")).unwrap();
        std::fs::create_dir(at("b")).unwrap();
        let folders = vec![(at("a"), Vec::new()), (at("b"), Vec::new())];
        assert_eq!(recordings(&[at("a"), at("b")]).unwrap(), folders);
        let files = vec![at("run_1.mcap"), at("run_0.mcap")];
        assert_eq!(recordings(&files).unwrap(), [(at("run_1.mcap"), files.clone())]);
        let error = recordings(&[at("a"), at("run_0.mcap")]).unwrap_err().to_string();
        assert!(error.contains("run_0.mcap is a file") && error.contains("a a folder"), "{error}");
    }
}
